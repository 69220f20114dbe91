# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Shared landmarks of two maps that contradict the others: moved, or mapped at a wrong place.

A few of them must not prevent a join. The pose of one map in the other is found
without them by consensus, see :mod:`fej_slam_ros.core.point_consensus`.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve

from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.ekf.state import JointState, Landmark, position_indices, Variables
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.frame_fit import (
    determine_heading, fit, FrameFit, shared_variables, StackedVariables)
from fej_slam_ros.core.point_consensus import farthest_points, MAX_OUTLYING, OUTLIER_D2
from fej_slam_ros.core.records import LandmarkKey

#: Numbers of shared variables between which a landmark that was observed once must not decide the
#: join: fewer cannot confirm it, more do not depend on it.
MIN_SHARED, MAX_SHARED = 3, 8
#: Squared Mahalanobis distance from the others beyond which such a landmark is removed; a correct
#: one exceeds it with probability 1e-3, and its next observation starts it again.
SINGLE_OBSERVATION_D2 = chi_square_limit(2, 1e-3)


def outlying_landmarks(
    team: JointState, group: JointState, tail: float
) -> tuple[LandmarkKey, ...]:
    """
    Return the shared landmarks that contradict the others; none if these are too many.

    They are found by consensus of the landmarks, or are of those that either frame observed only
    once, whose IDs may be misread. The others must fit with the given upper tail probability of
    chi-square.

    """
    shared = shared_variables(team, group)
    ours, theirs = ([v for v in variables if isinstance(v, Landmark)] for variables in shared)
    in_team, in_group = (
        state.estimates_of(position_indices(landmarks))
        for state, landmarks in ((team, ours), (group, theirs)))
    most = int(MAX_OUTLYING * len(ours))
    farthest = [ours[k].key for k in farthest_points(in_team, in_group, most)]
    found = _contradicting(team, group, farthest, tail)
    once = _observed_once(*shared)
    if found or len(shared[0]) - len(once) < MIN_SHARED:
        return found
    return _contradicting(team, group, once, tail)


def _observed_once(ours: Variables, theirs: Variables) -> list[LandmarkKey]:
    """Return the shared landmarks that either frame observed once, whose IDs may be misread."""
    return [
        our.key for our, their in zip(ours, theirs)
        if isinstance(our, Landmark) and isinstance(their, Landmark)
        and not (our.is_reobserved and their.is_reobserved)]


def _contradicting(
    team: JointState, group: JointState, keys: Sequence[LandmarkKey], tail: float
) -> tuple[LandmarkKey, ...]:
    """Return which of some landmarks contradict the others; none if these do not fit."""
    candidates = frozenset(keys)
    if not candidates or not determine_heading(team, group, candidates):
        return ()
    found = fit(team, group, candidates)
    if not found.is_consistent(tail):
        return ()
    return tuple(
        key for key, d2 in zip(keys, _increases_of_chi2(found, team, group, keys))
        if d2 > OUTLIER_D2)


def _increases_of_chi2(
    found: FrameFit, team: JointState, group: JointState, left_out: Sequence[LandmarkKey]
) -> list[float]:
    """
    Return by how much the chi2 of a fit increases with each landmark that it left out.

    It is the squared Mahalanobis distance of a landmark's residual from the one that those of the
    fit predict: all landmarks of a map share the errors of its robots.

    """
    ours, theirs = (
        StackedVariables([*shared, *(state.landmarks[key] for key in left_out)])
        for state, shared in zip((team, group), shared_variables(team, group, left_out)))
    g = found.pose
    at = ours.carried(g, group.estimates_of(theirs.indices))
    D = ours.derivative(g, at)
    S = team.marginal(ours.variables) + ours.turned_covariance(g, group.marginal(theirs.variables))
    r = ours.difference(team.estimates_of(ours.indices), at)
    of_fit, rest = slice(len(found.r)), slice(len(found.r), None)
    K = cho_solve(found.S_factor, S[of_fit, rest]).T
    e, D_e = r[rest] - K @ found.r, D[rest] - K @ found.D
    S_e = S[rest, rest] - K @ S[of_fit, rest] + D_e @ found.P @ D_e.T
    pairs = (slice(start, start + 2) for start in range(0, len(e), 2))
    return [float(e[own] @ np.linalg.solve(S_e[own, own], e[own])) for own in pairs]


def single_observation_failure(
    team: JointState, group: JointState, max_heading_sigma: float
) -> JoinFailure | None:
    """
    Return a failure if a shared landmark that either frame observed only once decides the join.

    Its ID may be misread. It decides alone if the others determine the heading with a larger
    standard deviation than the given one [rad], and is an outlier if they contradict it.

    """
    ours, theirs = shared_variables(team, group)
    if not MIN_SHARED <= len(ours) <= MAX_SHARED:
        return None
    worst, largest = None, SINGLE_OBSERVATION_D2
    for key in _observed_once(ours, theirs):
        found = fit(team, group, {key}) if determine_heading(team, group, {key}) else None
        if found is None or found.heading_sigma() > max_heading_sigma:
            return JoinFailure(
                f'landmark {key[1]}, which was observed once, determines the heading alone')
        (d2,) = _increases_of_chi2(found, team, group, [key])
        if d2 > largest:
            worst, largest = key, d2
    return worst and JoinFailure(
        f'landmark {worst[1]}, which was observed once, contradicts the others',
        outlying_landmarks=(worst,))
