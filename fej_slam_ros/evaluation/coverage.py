# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Consistency of estimates: NEES, its chi-square band, and coverage.

The band is the 95 % interval of the mean NEES of a consistent estimate with independent samples.
The samples of one run are correlated, since an early error persists; their autocorrelation gives
an equivalent number of independent samples, and its band. Robots also share errors of the map.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtr, erf

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.definiteness import are_definite
from fej_slam_ros.core.geometry import Array, pose_difference
from fej_slam_ros.evaluation.run_result import MatchedPoses

#: Probabilities of the confidence regions whose coverage is reported.
REGIONS = {
    **{f'{k}_sigma': float(erf(k / np.sqrt(2.0))) for k in (1, 2, 3)}, '95_percent': 0.95}


@dataclass(frozen=True, slots=True, eq=False)
class ConsistencyStatistics:
    """NEES/dof of a series of estimates."""

    values: Array  #: (n,) array
    dof: int  #: dimension of one error
    #: equivalent number of independent samples, None where samples have no order
    independent: float | None

    def coverage(self) -> dict[str, float]:
        """Return the share of errors inside each confidence region."""
        probabilities = chdtr(self.dof, self.dof * self.values)
        return {name: float(np.mean(probabilities <= p)) for name, p in REGIONS.items()}

    def as_dict(self) -> dict[str, Any] | None:
        """Return the statistics as plain data, None without samples."""
        samples = len(self.values)
        if not samples:
            return None
        data = {
            'mean': float(self.values.mean()), 'divided_by': self.dof, 'samples': samples,
            'coverage': self.coverage(), 'expected_coverage': REGIONS,
            'band_if_independent': band_per_dof(samples * self.dof)}
        if self.independent is not None:
            data |= {
                'independent_samples': self.independent,
                'band': band_per_dof(self.independent * self.dof)}
        return data


def pose_consistency(matched: MatchedPoses) -> tuple[Array, ConsistencyStatistics]:
    """Return NEES/3 (n,) of each pose, NaN for exactly known ones, and its statistics."""
    values = _nees_per_dof(pose_difference(matched.poses, matched.true), matched.P)
    uncertain = values[np.isfinite(values)]
    count = independent_samples(uncertain) if len(uncertain) else 0.0
    return values, ConsistencyStatistics(uncertain, 3, count)


def landmark_consistency(errors: Array, P: Array) -> ConsistencyStatistics:
    """Return NEES/2 of landmarks with errors (n, 2) and covariances P (n, 2, 2)."""
    values = _nees_per_dof(errors, P)
    return ConsistencyStatistics(values[np.isfinite(values)], 2, None)


def pooled(robots: Iterable[ConsistencyStatistics]) -> ConsistencyStatistics:
    """Return the statistics of the poses of several robots together."""
    statistics = [*robots]
    return ConsistencyStatistics(
        np.concatenate([np.empty(0), *(s.values for s in statistics)]), 3,
        sum(s.independent or 0.0 for s in statistics))


def independent_samples(values: Array) -> float:
    """
    Return the number of independent samples whose mean is as certain as that of a series (n,).

    It is n / (1 + 2 sum rho_k) over the autocorrelations before the first that is not positive.
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


def _nees_per_dof(errors: Array, P: Array) -> Array:
    """Return NEES/dof (n,), NaN where the covariance is singular."""
    uncertain = are_definite(P)
    values = np.full(len(errors), np.nan)
    if uncertain.any():
        values[uncertain] = nees_per_dof(errors[uncertain], P[uncertain])
    return values
