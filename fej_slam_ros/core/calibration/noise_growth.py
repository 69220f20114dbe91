# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Growth of the noise of observations with the range, by maximum likelihood.

Detectors often state one standard deviation for all ranges, while the noise of cameras is in
proportion to the range. The model has the standard deviation s (1 + g rho) times the stated one
at a range rho, with one g for all robots, and a factor s for each kind of observations.
"""

from collections.abc import Iterable, Sequence
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from fej_slam_ros.core.calibration.scales_of_errors import MIN_VARIANCE
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.parameter_kinds import MAX_NOISE_GROWTH

#: Number of errors from which growth is fitted.
MIN_ERRORS = 200
#: Smallest growth that is searched [1/m].
MIN_NOISE_GROWTH = 1e-3
#: Gain of the log-likelihood from which noise grows: that of four standard deviations.
MIN_GROWTH_GAIN = 8.0


class ErrorAtRange(NamedTuple):
    """Error of observations, or the sum of some."""

    range: float  #: mean range [m]
    d2: float  #: squared, normalised by the stated noise


def noise_growth(
    kinds: Iterable[Sequence[ErrorAtRange]], stated: float = 0.0, gain: float = MIN_GROWTH_GAIN
) -> float | None:
    """
    Return the growth g [1/m] of noise, 0 if there is none, None if there are too few errors.

    Parameters
    ----------
    kinds : errors without outliers of each kind of observations
    stated : growth that the stated noise has
    gain : gain of the log-likelihood from which noise grows

    """
    # Observations without noise, as of some simulators, show no growth.
    errors = [
        of_kind for of_kind in map(np.array, filter(len, kinds))
        if np.mean(of_kind[:, 1]) > MIN_VARIANCE]
    if sum(map(len, errors)) < MIN_ERRORS:
        return None

    def cost(growth: float) -> float:
        return sum(_cost(of_kind, growth, stated) for of_kind in errors)

    found = minimize_scalar(
        lambda log_growth: cost(math.exp(log_growth)), method='bounded',
        bounds=(math.log(MIN_NOISE_GROWTH), math.log(MAX_NOISE_GROWTH)))
    return math.exp(found.x) if cost(0.0) - found.fun > gain else 0.0


def _cost(errors: Array, growth: float, stated: float) -> float:
    """Return -log likelihood of the errors (m, 2) of one kind, for s^2 = mean(d2 / v)."""
    ranges, d2 = errors.T
    v = ((1.0 + growth * ranges) / (1.0 + stated * ranges)) ** 2
    return len(d2) * math.log(np.mean(d2 / v)) + float(np.sum(np.log(v)))
