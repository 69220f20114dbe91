# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Standard deviations of odometry without covariance, by maximum likelihood against ground truth.

One factor on all of them cannot mend a wrong ratio of those of positions to that of turns. The
covariance of the motion over a window is linear in both: P = a A + b B, for factors a and b of the
variances of positions and of turns.
"""

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from fej_slam_ros.core.calibration.scales_of_errors import MIN_VARIANCE, OUTLIER_PROBABILITY
from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.consistency import nees
from fej_slam_ros.core.geometry import Array

#: Number of windows from which both are fitted: their ratio is known to 10 % then.
MIN_WINDOWS = 100
#: Ratio of both factors of standard deviations from which one of both for all does not do.
MIN_RATIO = 1.3


class MotionError(NamedTuple):
    """Error of the motion over a window."""

    e: Array  #: (3,) array [m, m, rad]
    P: Array  #: (3, 3) array, its stated covariance


def sigma_factors(
    errors: Sequence[MotionError], larger: Sequence[MotionError]
) -> tuple[float, float] | None:
    """
    Return the factors of the standard deviations of positions and of turns.

    None if one factor of both fits, if there are too few errors, or if these are rounding only.

    Parameters
    ----------
    errors, larger : the same errors, with the covariance as stated, and with that for twice the
        standard deviation of turns

    """
    if len(errors) < MIN_WINDOWS:
        return None
    e, P, P_larger = (np.array(x) for x in (
        [error.e for error in errors], [error.P for error in errors],
        [error.P for error in larger]))
    B = (P_larger - P) / 3.0
    A = P - B

    def cost(log_factors: Array) -> float:
        """Return -log likelihood, in which gross errors count as their limit."""
        a, b = np.exp(2.0 * log_factors)
        S = a * A + b * B
        d2 = np.minimum(nees(e, S), chi_square_limit(3, OUTLIER_PROBABILITY))
        return 0.5 * float(np.sum(np.linalg.slogdet(S)[1] + d2))

    variance = float(np.median(nees(e, P))) / chi_square_limit(3, 0.5)
    if variance < MIN_VARIANCE:
        # Odometry without noise, as of some simulators, determines none.
        return None
    start = math.log(variance) / 2.0
    found = minimize(cost, [start, start], method='Nelder-Mead')
    position, turn = np.exp(found.x).tolist()
    return (position, turn) if abs(math.log(turn / position)) > math.log(MIN_RATIO) else None
