# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Wrong observations in a smoothed map, found by what is left of them at the minimum.

A filter must judge an observation when it comes; a smoother has all others to judge it by. The limit
is such that in a whole run of right observations none is gated, with the stated probability: what is
right stays as it was measured, to the last digit.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from fej_slam_ros.core.chi_square import squared_distances
from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.least_squares import concatenated, LandmarkFactors

#: Where more than this part of the observations are wrong, the noise is not what it is said to be,
#: and nobody can tell right from wrong: all of them are taken.
MAX_SHARE = 0.25
#: Gating goes on no longer than this.
MAX_ROUNDS = 50


@dataclass(frozen=True, slots=True)
class Outlier:
    """
    An observation that is left out.

    Attributes
    ----------
    pose : number of the pose that saw
    landmark : key of what was seen
    d2, limit : squared Mahalanobis norm of its residual when it was left out, and what is allowed

    """

    pose: int
    landmark: LandmarkKey
    d2: float
    limit: float


def minimum(alone: LocalMap, probability: float) -> tuple[LocalMap, list[Outlier]]:
    """
    Return a robot's map at the minimum without wrong observations, and these.

    Parameters
    ----------
    alone : the map; its values are where to start
    probability : with this one no right observation of the whole map is left out; 1.0 takes all

    Raises
    ------
    SingularError, ConvergenceError
        As `least_squares.solve` does.

    """
    plain = _solved(alone)
    count = len(alone.problem.observations.z)
    limit = float(chi2.ppf(probability ** (1.0 / max(count, 1)), 2))
    outliers: list[Outlier] = []
    kept = plain
    for _ in range(MAX_ROUNDS):
        wrong = _wrong(kept, limit)
        if not wrong:
            break
        seen = concatenated(kept.problem.observations)
        outliers += [
            Outlier(int(seen.pose[m]), kept.landmarks[seen.landmark[m]], d2, limit)
            for m, d2 in wrong]
        if len(outliers) > MAX_SHARE * count:
            return plain, []
        left = np.delete(np.arange(len(seen.z)), [m for m, _ in wrong])
        kept = _solved(replace(kept, problem=replace(kept.problem, observations=LandmarkFactors(
            seen.pose[left], seen.landmark[left], seen.z[left], seen.R[left]))))
    return kept, outliers


def _solved(alone: LocalMap) -> LocalMap:
    return replace(alone, values=least_squares.solve(alone.problem, alone.values).values)


def _wrong(alone: LocalMap, limit: float) -> list[tuple[int, float]]:
    """
    Return which observations are surely wrong, and how badly they fit.

    A wrong one makes others fit badly, so that only those go at a time that fit worst of their
    pose and of their landmark, and not much better than the worst of all.

    """
    seen = concatenated(alone.problem.observations)
    _, r = seen.linearized(alone.values)
    d2 = squared_distances(r, seen.covariance())
    worst = np.intersect1d(_worst_of_each(seen.pose, d2), _worst_of_each(seen.landmark, d2))
    least = max(limit, d2.max(initial=0.0) / 4.0)
    return [(int(m), float(d2[m])) for m in worst if d2[m] > least]


def _worst_of_each(group: Indices, d2: Array) -> Indices:
    """Return for each group which of its members fits worst, one of them."""
    worst_first = np.lexsort((-d2, group))
    _, firsts = np.unique(group[worst_first], return_index=True)
    worst: Indices = worst_first[firsts]
    return worst
