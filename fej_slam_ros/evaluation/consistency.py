# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether covariances can be believed: NEES, its chi-square band, and coverage.

A band is where the mean NEES of a consistent estimate lies with 95 %, if its samples were
independent. Those of one run are not: an error made early stays. From their autocorrelation
follows as how many independent ones they count, and a band for so many. That is an estimate, and
it does not know that robots share the errors of their map.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtr, erf

from fej_slam_ros.core.chi_square import chi_square_band
from fej_slam_ros.core.consistency import is_definite, nees
from fej_slam_ros.core.geometry import Array, wrap_all
from fej_slam_ros.evaluation.run_result import MatchedPoses

BAND = 0.95
#: Probabilities with which a true value lies inside, by the names of the regions.
REGIONS = {
    **{f'{k}_sigma': float(erf(k / np.sqrt(2.0))) for k in (1, 2, 3)}, '95_percent': 0.95}


@dataclass(frozen=True, slots=True, eq=False)
class ConsistencyStatistics:
    """
    NEES of some estimates, divided by its dimension, in their order.

    Attributes
    ----------
    values : (n,) array
    dof : the dimension
    independent : as how many independent values they count, about; None where nobody knows

    """

    values: Array
    dof: int
    independent: float | None

    def band(self, samples: float) -> tuple[float, float]:
        """Return where the mean of so many independent values of a consistent estimate lies."""
        dof = samples * self.dof
        low, high = chi_square_band(dof, BAND)
        return low / dof, high / dof

    def coverage(self) -> dict[str, float]:
        """Return which part of the errors lies inside of each region."""
        probabilities = chdtr(self.dof, self.dof * self.values)
        return {name: float(np.mean(probabilities <= p)) for name, p in REGIONS.items()}


def rate_poses(of: MatchedPoses) -> tuple[Array, ConsistencyStatistics]:
    """Return NEES / 3 of each pose (n,), NaN where it is exactly known, and those of the rest."""
    errors = of.poses - of.true
    errors[:, 2] = wrap_all(errors[:, 2])
    return _rated(errors, of.P, in_time=True)


def rate_points(errors: Array, P: Array) -> ConsistencyStatistics:
    """Return NEES / 2 of landmarks with errors (n, 2) and covariances P (n, 2, 2)."""
    return _rated(errors, P, in_time=False)[1]


def pooled(ratings: Iterable[ConsistencyStatistics]) -> ConsistencyStatistics:
    """Return the ratings of the poses of several robots as one."""
    told = [*ratings]
    return ConsistencyStatistics(
        np.concatenate([np.empty(0), *(of.values for of in told)]), 3,
        sum(of.independent or 0.0 for of in told))


def nis_band(dof: int) -> tuple[float, float]:
    """Return where NIS per degree of freedom of a consistent filter lies."""
    low, high = chi_square_band(dof, BAND)
    return low / dof, high / dof


def independent_samples(values: Array) -> float:
    """
    Return as how many independent values a series (n,) counts for its mean.

    That is n / (1 + 2 sum rho_k) over the autocorrelations before the first that is not positive.

    """
    n = len(values)
    centred = values - values.mean()
    power = np.abs(np.fft.rfft(centred, 2 * n)) ** 2
    covariances = np.fft.irfft(power)[:n]
    if not covariances[0] > 0.0:
        return 1.0
    rho = covariances[1:] / covariances[0]
    end = int(np.argmax(rho <= 0.0)) if (rho <= 0.0).any() else len(rho)
    return max(1.0, float(n / (1.0 + 2.0 * rho[:end].sum())))


def told(ratings: ConsistencyStatistics) -> dict[str, Any] | None:
    """Return ratings as plain data, None where there are none."""
    samples = len(ratings.values)
    if not samples:
        return None
    data = {
        'mean': float(ratings.values.mean()),
        'divided_by': ratings.dof,
        'samples': samples,
        'coverage': ratings.coverage(),
        'expected_coverage': REGIONS,
        'band_if_independent': ratings.band(samples),
    }
    if ratings.independent is not None:
        data |= {
            'independent_samples': ratings.independent,
            'band': ratings.band(ratings.independent)}
    return data


def _rated(errors: Array, P: Array, in_time: bool) -> tuple[Array, ConsistencyStatistics]:
    uncertain = np.array([is_definite(block) for block in P], dtype=bool)
    values = np.full(len(errors), np.nan)
    if uncertain.any():
        values[uncertain] = nees(errors[uncertain], P[uncertain])
    known = values[uncertain]
    count = None if not in_time else independent_samples(known) if len(known) else 0.0
    return values, ConsistencyStatistics(known, errors.shape[1], count)
