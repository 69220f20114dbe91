# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Outliers among the landmark observations of a smoothed map, found by their residuals.

Unlike a filter, a smoother tests an observation against all others. The limit is such that with
the given probability no correct observation of a whole run is removed.
"""

from dataclasses import dataclass, replace

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_quantile, squared_distances
from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.least_squares import concatenated, LandmarkFactors, Values

#: Largest fraction of outliers; with more, the stated noise is wrong and none is removed.
MAX_OUTLIER_FRACTION = 0.25
#: Rounds of removal; bounds the time.
MAX_ROUNDS = 50


@dataclass(frozen=True, slots=True)
class Outlier:
    """A landmark observation that was removed."""

    pose: int  #: index of the observing pose
    landmark: LandmarkKey  #: key of the landmark
    #: d2, limit: squared Mahalanobis norm of its residual when it was removed, and the limit
    d2: float
    limit: float


def without_outliers(local: LocalMap, probability: float) -> tuple[LocalMap, list[Outlier]]:
    """
    Return a robot's map at the minimum without outliers, and the outliers.

    `probability` is that of removing no correct observation of the map; 1.0 keeps all.

    """
    complete = kept = _solved(local)
    count = len(local.problem.landmarks.z)
    limit = chi_square_quantile(2, probability ** (1.0 / max(count, 1)))
    outliers: list[Outlier] = []
    for _ in range(MAX_ROUNDS):
        factors = concatenated(kept.problem.landmarks)
        worst = _worst(factors, kept.values, limit)
        if not worst:
            break
        outliers += [
            Outlier(int(factors.pose[m]), kept.landmarks[factors.target[m]], d2, limit)
            for m, d2 in worst.items()]
        if len(outliers) > MAX_OUTLIER_FRACTION * count:
            return complete, []
        rows = np.delete(np.arange(len(factors.z)), list(worst))
        kept = _solved(replace(kept, problem=replace(kept.problem, landmarks=LandmarkFactors(
            factors.pose[rows], factors.target[rows], factors.z[rows], factors.R[rows]))))
    return kept, outliers


def _solved(local: LocalMap) -> LocalMap:
    return replace(local, values=least_squares.solve(local.problem, local.values).values)


def _worst(factors: LandmarkFactors, values: Values, limit: float) -> dict[int, float]:
    """Return the rows and d2 of the outliers that are removed at a time."""
    _, r = factors.linearize(values)
    d2 = squared_distances(r, factors.R)
    # An outlier worsens the fit of other observations, so that only the worst ones are certain:
    # those that fit worst of their pose and of their landmark, with a large d2.
    worst = np.intersect1d(
        _worst_of_each(factors.pose, d2), _worst_of_each(factors.target, d2))
    least = max(limit, d2.max(initial=0.0) / 4.0)
    return {int(m): float(d2[m]) for m in worst if d2[m] > least}


def _worst_of_each(group: Indices, d2: Array) -> Indices:
    """Return the row with the largest d2 in each group."""
    order = np.lexsort((-d2, group))
    _, firsts = np.unique(group[order], return_index=True)
    return order[firsts]
