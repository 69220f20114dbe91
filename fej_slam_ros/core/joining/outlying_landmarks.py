# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Shared landmarks of two maps that contradict the others: moved, or mapped at a wrong place.

A few of them must not keep two maps apart for ever. The pose of one map in the other is found
without them by consensus: each landmark, with the one farthest from it, gives a rigid motion, and
the motion that carries most landmarks closest to their places in the other map decides.
"""

import numpy as np
from scipy.special import chdtri

from fej_slam_ros.core.ekf.state import JointState, Landmark
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.joining.frame_fit import (
    carried, derivatives, determine_heading, difference, fit, FrameFit, indices, shared_variables)
from fej_slam_ros.core.records import LandmarkKey

#: A landmark or rendezvous point is an outlier if chi-square without it is less by more than this;
#: a correct one exceeds it with probability 1e-6.
OUTLIER_D2 = float(chdtri(2, 1e-6))
#: Share of the shared landmarks that may contradict the others.
MAX_OUTLYING = 0.2


def outlying_landmarks(
    team: JointState, group: JointState, tail: float
) -> tuple[LandmarkKey, ...]:
    """
    Return the shared landmarks that contradict the others; none if these are too many.

    The others must fit with the given upper tail probability of chi-square.

    """
    ours, theirs = ([v for v in of if isinstance(v, Landmark)]
                    for of in shared_variables(team, group))
    most = int(MAX_OUTLYING * len(ours))
    if not most:
        return ()
    points = (state.estimates_of(indices(of)).reshape(-1, 2)
              for state, of in ((team, ours), (group, theirs)))
    farthest = np.argsort(_distances(*points))[-most:]
    candidates = frozenset(ours[k].key for k in farthest)
    if not determine_heading(team, group, candidates):
        return ()
    found = fit(team, group, candidates)
    if found.chi2 > chdtri(found.dof, tail):
        return ()
    return tuple(
        ours[k].key for k in farthest
        if _squared_distance(found, team, group, ours[k], theirs[k]) > OUTLIER_D2)


def _distances(a: Array, b: Array) -> Array:
    """Return the distances (L,) of points a (L, 2) from b (L, 2) by the rigid motion of most."""
    x, y = (points @ [1.0, 1.0j] for points in (a, b))
    far = np.abs(y[:, None] - y).argmax(axis=1)
    turn = (x[far] - x) * np.conj(y[far] - y)
    turn /= np.maximum(np.abs(turn), np.finfo(float).tiny)
    # Row k is of the motion by landmark k and the one farthest from it.
    distances = np.abs(x[:, None] + turn[:, None] * (y - y[:, None]) - x)
    most = int(MAX_OUTLYING * len(a))
    best = np.partition(distances, -most - 1, axis=1)[:, -most - 1].argmin()
    return np.asarray(distances[best])


def _squared_distance(
    found: FrameFit, team: JointState, group: JointState, our: Landmark, their: Landmark
) -> float:
    """Return the squared Mahalanobis distance of two estimates of a landmark left out of a fit."""
    x, at = team.estimate(our), carried(found.pose, group.estimate(their), [our])
    C, D = derivatives(found.pose, at, [our])
    S = team.marginal([our]) + C @ group.marginal([their]) @ C.T + D @ found.P @ D.T
    r = difference(x, at, [our])
    return float(r @ np.linalg.solve(S, r))
