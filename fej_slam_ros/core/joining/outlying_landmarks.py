# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Shared landmarks of two maps that contradict the others: moved, or mapped at a wrong place.

A few of them must not keep two maps apart for ever. The pose of one map in the other is found
without them by consensus, see :mod:`fej_slam_ros.core.point_consensus`.
"""

import numpy as np
from scipy.special import chdtri

from fej_slam_ros.core.ekf.state import JointState, Landmark
from fej_slam_ros.core.joining.frame_fit import (
    carried, derivatives, determine_heading, difference, fit, FrameFit, indices, shared_variables)
from fej_slam_ros.core.point_consensus import farthest_points, OUTLIER_D2
from fej_slam_ros.core.records import LandmarkKey


def outlying_landmarks(
    team: JointState, group: JointState, tail: float
) -> tuple[LandmarkKey, ...]:
    """
    Return the shared landmarks that contradict the others; none if these are too many.

    The others must fit with the given upper tail probability of chi-square.

    """
    ours, theirs = ([v for v in of if isinstance(v, Landmark)]
                    for of in shared_variables(team, group))
    points = (state.estimates_of(indices(of)).reshape(-1, 2)
              for state, of in ((team, ours), (group, theirs)))
    farthest = farthest_points(*points)
    candidates = frozenset(ours[k].key for k in farthest)
    if not candidates or not determine_heading(team, group, candidates):
        return ()
    found = fit(team, group, candidates)
    if found.chi2 > chdtri(found.dof, tail):
        return ()
    return tuple(
        ours[k].key for k in farthest
        if _squared_distance(found, team, group, ours[k], theirs[k]) > OUTLIER_D2)


def _squared_distance(
    found: FrameFit, team: JointState, group: JointState, our: Landmark, their: Landmark
) -> float:
    """Return the squared Mahalanobis distance of two estimates of a landmark left out of a fit."""
    x, at = team.estimate(our), carried(found.pose, group.estimate(their), [our])
    C, D = derivatives(found.pose, at, [our])
    S = team.marginal([our]) + C @ group.marginal([their]) @ C.T + D @ found.P @ D.T
    r = difference(x, at, [our])
    return float(r @ np.linalg.solve(S, r))
