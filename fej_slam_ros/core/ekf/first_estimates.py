# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
First estimates that are too far off to linearise at, and their renewal.

This is not in [Liu]. Where a map has been corrected by metres, a landmark nearby may lie in any
direction at its first estimate, and H corrects the heading by an offset that has nothing to do
with the true one. And where maps join, a whole map may turn, at the join or later, and all its
Jacobians are then wrong by that turn. The estimate then becomes the first estimate of a landmark.

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
from fej_slam_ros.core.pieces import PIECE_ELEMENTS, ranges

#: Distance of a first estimate from the estimate of an observed point, divided by that of the
#: observer, up to which it is kept. Beyond 1 it may lie in any direction.
MAX_MOVED = 1.0
#: Distance of a first estimate from the estimate of a landmark, divided by that of the nearest
#: robot, up to which it is kept when a heading is corrected far: about the error of H [rad]. Of
#: five robots behind walls, MRCLAM 6, NEES/3 is nearly the same at 0.1.
MAX_DISPLACED = 0.2
#: Ratio of the variances of a point in the frames of two robots up to which it may turn with both.
SIMILAR = 10.0


def far_points(state: JointState, columns: Indices) -> Indices:
    """Return the points (k, 2) far from their first estimates, of observations (m, 5)."""
    estimates, points = state.estimates_of(columns), columns[:, 3:]
    moved = norm(estimates[:, 3:] - state.x_first.take(points), axis=1)
    distance = norm(estimates[:, 3:] - estimates[:, :2], axis=1)
    return np.unique(points[moved > MAX_MOVED * distance], axis=0)


def displaced_landmarks(state: JointState) -> Indices:
    """Return the landmarks (k, 2) far from their first estimates, of a state with robots."""
    landmarks, robots = state.landmark_positions(), position_indices([*state.robots.values()])
    points = state.estimates_of(landmarks)
    moved = norm(points - state.x_first[landmarks], axis=1)
    distance = norm(points[:, None] - state.x_hat[robots], axis=2).min(axis=1)
    displaced: Indices = landmarks[moved > MAX_DISPLACED * distance]
    return displaced


def renew(state: JointState, points: Indices) -> None:
    """Let points (k, 2), of which there may be none, have their estimates as first estimates."""
    if not len(points):
        return
    P = state.whole()
    headings, of_point = np.unique(_nearest_headings(state, P, points), return_inverse=True)
    V = np.zeros((P.dimension, len(headings)))
    V[points, of_point[:, None]] = perpendicular(state.x_hat[points] - state.x_first[points])
    P.transport(Transport(headings, V, np.zeros(P.dimension), state.heading_of))
    state.x_first[points] = state.x_hat[points]


def _nearest_headings(state: JointState, P: JointCovariance, points: Indices) -> Indices:
    """Return the most certain heading of the robots in whose frames each point is known best."""
    poses = pose_indices([*state.robots.values()])
    N, uncertain = len(poses), P.blocks(poses[:, 2:])[:, 0, 0]
    headings = np.empty(len(points), np.intp)
    for part in ranges(len(points), PIECE_ELEMENTS / (25 * N)):
        columns = np.hstack([
            np.tile(poses, (len(points[part]), 1)), np.repeat(points[part], N, axis=0)])
        H = KERNEL.H(state.x_first.take(columns))
        S = H @ P.blocks(columns) @ H.transpose(0, 2, 1)
        variances = S.trace(axis1=1, axis2=2).reshape(-1, N)
        is_near = variances <= SIMILAR * variances.min(axis=1, keepdims=True)
        headings[part] = poses[np.where(is_near, uncertain, np.inf).argmin(axis=1), 2]
    return headings
