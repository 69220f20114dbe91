# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Outliers among the landmark observations of a smoothed map, found by their residuals.

Unlike a filter, a smoother tests an observation against all others. The limit is such that with
the given probability no correct observation of a whole run is removed.
"""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import compress

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_quantile, squared_distances
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.gauss_newton import ConvergenceError
from fej_slam_ros.core.geometry import Array, compose, Indices, transform
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing.cauchy_loss import CauchyLoss
from fej_slam_ros.core.smoothing.factors import concatenated, LandmarkFactors, rows_of, Values
from fej_slam_ros.core.smoothing.least_squares import TOLERANCE

#: Largest fraction of outliers; with more, the stated noise is wrong and none is removed.
MAX_OUTLIER_FRACTION = 0.25
#: Cost by which outliers are found first: those beyond 95 % of correct observations count less.
ROBUST_LOSS = CauchyLoss(chi_square_quantile(2, 0.95))
#: Largest increment of a coordinate at its minimum [m, rad]: it shows outliers, but is no result,
#: and reweighted squares converge slowly.
ROBUST_TOLERANCE = 1e-4
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


def without_outliers(own: JointMap, probability: float) -> tuple[JointMap, list[Outlier]]:
    """
    Return a single robot's map at the minimum without outliers, and the outliers.

    `probability` is that of removing no correct observation of the map; 1.0 keeps all.

    Raises
    ------
    SingularError, ConvergenceError
        As of `least_squares`, also without the outliers that a robust cost shows.

    """
    limit = outlier_limit(own, probability)
    complete = _minimum(own)
    if complete is not None and not _worst(complete, limit):
        return complete, []
    # Outliers worsen the fit of correct observations, most of all where they prevent a minimum.
    robust = robust_minimum(own)
    kept, outliers = (complete or own, []) if robust is None else _without(
        robust, _beyond(robust, limit), limit)
    kept, others = _in_rounds(kept, limit)
    outliers += others
    if len(outliers) > MAX_OUTLIER_FRACTION * len(own.problem.landmarks.z):
        return complete or own.solved(), []
    return kept, outliers


def robust_minimum(own: JointMap) -> JointMap | None:
    """Return a map at the minimum of the cost by which outliers are found, None without one."""
    return _minimum(own, ROBUST_LOSS, ROBUST_TOLERANCE) or _minimum(
        replace(own, values=_by_odometry(own)), ROBUST_LOSS, ROBUST_TOLERANCE)


def outlier_limit(own: JointMap, probability: float) -> float:
    """Return the limit of d2 beyond which no observation is, with the given probability."""
    count = len(own.problem.landmarks.z)
    return chi_square_quantile(2, probability ** (1.0 / max(count, 1)))


def count_beyond(own: JointMap, limit: float) -> int:
    """Return the number of landmark observations of a map that are beyond a limit of d2."""
    _, d2 = _distances(own)
    return int(np.sum(d2 > limit))


def without_landmarks(
    joint: JointMap, d2: Mapping[LandmarkKey, float], limit: float
) -> tuple[JointMap, dict[str, list[Outlier]]]:
    """
    Return the minimum without some landmarks, and their observations as outliers of each robot.

    `d2` has the squared Mahalanobis distance by which each of the landmarks contradicts others,
    by one of its keys; it is above the limit.

    """
    factors, index = joint.problem.landmarks, joint.landmark_index()
    keys = {index[key]: key for key in d2}
    is_kept = ~np.isin(np.arange(len(joint.landmarks)), [*keys])
    rows = is_kept[factors.target]
    firsts = [joint.first_poses[robot] for robot in joint.robots]
    outliers: dict[str, list[Outlier]] = {robot: [] for robot in joint.robots}
    for pose, target in zip(factors.pose[~rows].tolist(), factors.target[~rows].tolist()):
        owner, key = bisect_right(firsts, pose) - 1, keys[target]
        outliers[joint.robots[owner]].append(Outlier(pose - firsts[owner], key, d2[key], limit))
    kept = rows_of(factors, np.flatnonzero(rows))
    kept = replace(kept, target=(np.cumsum(is_kept) - 1)[kept.target])
    return replace(
        joint, problem=replace(joint.problem, landmarks=kept),
        values=Values(joint.values.poses, joint.values.points[is_kept]),
        landmarks=tuple(compress(joint.landmarks, is_kept))).solved(), outliers


def _in_rounds(own: JointMap, limit: float) -> tuple[JointMap, list[Outlier]]:
    """Return the minimum without outliers, of which each round removes the worst, and these."""
    outliers: list[Outlier] = []
    for _ in range(MAX_ROUNDS):
        own = own.solved()
        worst = _worst(own, limit)
        if not worst:
            return own, outliers
        own, others = _without(own, worst, limit)
        outliers += others
    return own.solved(), outliers


def _minimum(
    own: JointMap, loss: CauchyLoss | None = None, tolerance: float = TOLERANCE
) -> JointMap | None:
    """Return a map at the minimum of a cost, None if it is not reached."""
    try:
        return own.solved(loss, tolerance)
    except ConvergenceError:
        return None


def _by_odometry(own: JointMap) -> Values:
    """Return poses by odometry, landmarks by first observations, which no later outlier moves."""
    poses, points = own.values.poses.copy(), own.values.points.copy()
    odometry, factors = own.problem.odometry, own.problem.landmarks
    for begin, end, u in zip(odometry.pose.tolist(), odometry.target.tolist(), odometry.z):
        poses[end] = compose(poses[begin], u)
    landmarks, first = np.unique(factors.target, return_index=True)
    for landmark, k in zip(landmarks.tolist(), first.tolist()):
        points[landmark] = transform(poses[factors.pose[k]], factors.z[k])
    return Values(poses, points)


def _without(
    own: JointMap, removed: Mapping[int, float], limit: float
) -> tuple[JointMap, list[Outlier]]:
    """Return a map without some rows of its landmark observations, given with their d2."""
    factors = own.problem.landmarks
    rows = np.delete(np.arange(len(factors.z)), list(removed))
    kept = replace(own.problem, landmarks=rows_of(factors, rows))
    return replace(own, problem=kept), [
        Outlier(int(factors.pose[m]), own.landmarks[factors.target[m]][0], d2, limit)
        for m, d2 in removed.items()]


def _beyond(own: JointMap, limit: float) -> dict[int, float]:
    """Return the rows and d2 of all observations beyond a limit but the best of each landmark."""
    factors, d2 = _distances(own)
    is_beyond = d2 > limit
    is_beyond[_worst_of_each(factors.target, -d2)] = False
    return {int(m): float(d2[m]) for m in np.flatnonzero(is_beyond)}


def _worst(own: JointMap, limit: float) -> dict[int, float]:
    """Return the rows and d2 of the outliers that one round removes."""
    factors, d2 = _distances(own)
    # An outlier worsens the fit of other observations, so that only the worst ones are certain:
    # those that fit worst of their pose and of their landmark, with a large d2.
    worst = np.intersect1d(
        _worst_of_each(factors.pose, d2), _worst_of_each(factors.target, d2))
    least = max(limit, d2.max(initial=0.0) / 4.0)
    return {int(m): float(d2[m]) for m in worst if d2[m] > least}


def _distances(own: JointMap) -> tuple[LandmarkFactors, Array]:
    """Return the landmark observations of a map and their squared Mahalanobis distances."""
    factors = concatenated(own.problem.landmarks)
    _, r = factors.linearize(own.values)
    return factors, squared_distances(r, factors.R)


def _worst_of_each(group: Indices, d2: Array) -> Indices:
    """Return the row with the largest d2 in each group."""
    order = np.lexsort((-d2, group))
    _, firsts = np.unique(group[order], return_index=True)
    return order[firsts]
