# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
First estimates that are too far off to linearise at, and their renewal.

This is not in [Liu]. Where a map has been corrected by metres, a landmark nearby may lie in any
direction at its first estimate, and H corrects the heading by an offset that has nothing to do
with the true one; and where starts are unknown, whole maps may turn, at a join or later, and all
Jacobians are then wrong by that turn. Its estimate then becomes the first estimate of a landmark.

A rotation of the map moved the landmark by J f, and has to move it by J f_hat: its error gets
J (f_hat - f) theta, as in the invariant filter, with the most certain theta of the robots in whose
frames it is known best. So a rotation of the whole state, or of the part around these robots,
stays unobservable.
"""

import numpy as np
from numpy.linalg import norm

from fej_slam_ros.core.ekf.covariance import Transport
from fej_slam_ros.core.ekf.joint_covariance import JointCovariance
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.state import JointState, pose_indices, position_indices
from fej_slam_ros.core.geometry import Indices, perpendicular

#: Distance of a first estimate from the estimate of an observed point, divided by that of the
#: observer, up to which it is kept. Beyond 1 it may lie in any direction.
MAX_MOVED = 1.0
#: The same of any landmark, and the distance of the nearest robot, where maps have turned.
MAX_TURNED = 0.2
#: Ratio of the variances of a point in the frames of two robots up to which it may turn with both.
SIMILAR = 10.0


def far_points(state: JointState, columns: Indices) -> Indices:
    """Return the points (k, 2) far from their first estimates, of observations (m, 5)."""
    estimates, points = state.estimates_of(columns), columns[:, 3:]
    moved = norm(estimates[:, 3:] - state.x_first.take(points), axis=1)
    distance = norm(estimates[:, 3:] - estimates[:, :2], axis=1)
    return np.unique(points[moved > MAX_MOVED * distance], axis=0)


def turned_landmarks(state: JointState) -> Indices:
    """Return landmarks (k, 2) whose first estimates are wrong by a turn, none without robots."""
    state.whole()
    landmarks, robots = state.landmark_positions(), position_indices([*state.robots.values()])
    points = state.x_hat[landmarks]
    moved = norm(points - state.x_first[landmarks], axis=1)
    distance = norm(points[:, None] - state.x_hat[robots], axis=2).min(axis=1, initial=np.inf)
    turned: Indices = landmarks[moved > MAX_TURNED * distance]
    return turned


def renew(state: JointState, points: Indices) -> None:
    """Let points (k, 2), of which there may be none, have their estimates as first estimates."""
    if not len(points):
        return
    P = state.whole()
    headings, of_point = np.unique(
        [_nearest_heading(state, P, point) for point in points], return_inverse=True)
    V = np.zeros((P.dimension, len(headings)))
    V[points, of_point[:, None]] = perpendicular(state.x_hat[points] - state.x_first[points])
    P.transport(Transport(headings, V, np.zeros(P.dimension), state.heading_of))
    state.x_first[points] = state.x_hat[points]


def _nearest_heading(state: JointState, P: JointCovariance, point: Indices) -> int:
    """Return the most certain heading of the robots in whose frames a point (2,) is known best."""
    poses = pose_indices([*state.robots.values()])
    columns = np.column_stack([poses, np.tile(point, (len(poses), 1))])
    H = KERNEL.H(state.x_first.take(columns))
    S = H @ P.blocks(columns) @ H.transpose(0, 2, 1)
    variances = S.trace(axis1=1, axis2=2)
    headings = poses[variances <= SIMILAR * variances.min(), 2]
    return int(headings[np.argmin(P.blocks(headings[:, None])[:, 0, 0])])
