# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
First estimates that are too far off to linearise at, and their renewal.

This is not in [Liu]. Where a map has been corrected by metres, a landmark nearby may lie in any
direction at its first estimate, and H corrects the heading by an offset that has nothing to do
with the true one. Its estimate then becomes its first estimate. A rotation of the whole state
moved the landmark by J f, and has to move it by J f_hat: its error gets J (f_hat - f) theta, as in
the invariant filter, with the theta of the most certain heading. So it stays unobservable.
"""

import numpy as np
from numpy.linalg import norm

from fej_slam_ros.core.ekf.covariance import Transport
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.geometry import Indices, perpendicular

#: Distance of a first estimate from the estimate of an observed point, divided by that of the
#: observer, up to which it is kept. Beyond 1 it may lie in any direction.
MAX_MOVED = 1.0


def far_points(state: JointState, columns: Indices) -> Indices:
    """Return the points (k, 2) far from their first estimates, of observations (m, 5)."""
    estimates, points = state.estimates_of(columns), columns[:, 3:]
    moved = norm(estimates[:, 3:] - state.x_first.take(points), axis=1)
    distance = norm(estimates[:, 3:] - estimates[:, :2], axis=1)
    return np.unique(points[moved > MAX_MOVED * distance], axis=0)


def renew(state: JointState, points: Indices) -> None:
    """Let points (k, 2) have their estimates as first estimates."""
    P, theta = state.whole(), np.array([state.most_certain_heading()])
    V = np.zeros((P.dimension, 1))
    V[points, 0] = perpendicular(state.x_hat[points] - state.x_first[points])
    P.transport(Transport(theta, V, np.zeros(P.dimension), state.heading_of))
    state.x_first[points] = state.x_hat[points]
