# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Motion and observation models of section 2.2 of [Liu], and their Jacobians.

Pure functions under the paper's names. A Jacobian depends on its linearisation point only, which
the policies of :mod:`fej_slam_ros.core.ekf.linearization` choose.
"""

import numpy as np

from fej_slam_ros.core.geometry import Array, compose, pose_rotation, wrap_all


def f(x: Array, u: Array) -> Array:
    """Return the pose (3,) after an increment u (3,) from pose x (3,), eq. (2)."""
    return compose(x, u)


def Phi(d: Array) -> Array:
    """Return the (3, 3) transition of a pose error over the displacement d (2,) [m], eq. (5)."""
    return np.array([[1.0, 0.0, -d[1]], [0.0, 1.0, d[0]], [0.0, 0.0, 1.0]])


def Phi_all(d: Array) -> Array:
    """Return `Phi` of displacements d (k, 2), a (k, 3, 3) array."""
    transitions = np.broadcast_to(np.eye(3), (len(d), 3, 3)).copy()
    transitions[:, 0, 2], transitions[:, 1, 2] = -d[:, 1], d[:, 0]
    return transitions


def G(phi: float) -> Array:
    """Return the (3, 3) Jacobian of eq. (2) by the noise of u, at heading phi [rad], eq. (6)."""
    return pose_rotation(phi)


def composed_increment(u: Array, Q: Array, v: Array, R: Array) -> tuple[Array, Array]:
    """Return u (3,) followed by v (3,) as one increment, and its covariance by eqs. (4) to (6)."""
    C = G(u[2])
    Phi_v = Phi(C[:2, :2] @ v[:2])
    return f(u, v), Phi_v @ Q @ Phi_v.T + C @ R @ C.T


def h(poses: Array, points: Array) -> Array:
    """Return points (m, 2) in the base frames of m robots at poses (m, 3), eq. (7)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = points[:, 0] - poses[:, 0], points[:, 1] - poses[:, 1]
    z = np.empty((len(poses), 2))
    z[:, 0] = c * dx + s * dy
    z[:, 1] = c * dy - s * dx
    return z


def H(poses: Array, points: Array) -> Array:
    """
    Return the Jacobians of eq. (7) by pose and point, eqs. (10) and (11).

    Parameters
    ----------
    poses : (m, 3) array, poses to linearise at
    points : (m, 2) array, points to linearise at, in the frame of the poses

    Returns
    -------
    (m, 2, 5) array
        Columns x, y, phi of the pose, then x, y of the point.

    """
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy = points[:, 0] - poses[:, 0], points[:, 1] - poses[:, 1]
    # Columns of C^T times -I, -J (f - p) and I.
    blocks = np.empty((len(poses), 2, 5))
    blocks[:, 0, 3] = blocks[:, 1, 4] = c
    blocks[:, 0, 4] = s
    blocks[:, 1, 3] = -s
    blocks[:, :, :2] = -blocks[:, :, 3:]
    blocks[:, 0, 2] = c * dy - s * dx
    blocks[:, 1, 2] = -c * dx - s * dy
    return blocks


def h_pose(poses: Array, others: Array) -> Array:
    """Return `between` of m poses and m other poses, (m, 3) arrays."""
    return np.column_stack([h(poses, others[:, :2]), wrap_all(others[:, 2] - poses[:, 2])])


def H_pose(poses: Array, others: Array) -> Array:
    """
    Return the Jacobians of `h_pose` by both poses.

    Parameters
    ----------
    poses, others : (m, 3) arrays, poses to linearise at, in one frame; of others, positions (m, 2)
        are enough

    Returns
    -------
    (m, 3, 6) array
        Columns x, y, phi of the pose, then x, y, phi of the other.

    """
    D = np.zeros((len(poses), 3, 6))
    D[:, :2, :5] = H(poses, others[:, :2])
    D[:, 2, 2], D[:, 2, 5] = -1.0, 1.0
    return D


def F(b: Array) -> Array:
    """Return the (2, 3) Jacobian of a new landmark by its observer's pose, b (2,) away [m]."""
    return np.array([[1.0, 0.0, -b[1]], [0.0, 1.0, b[0]]])
