# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The local observability matrix M of a filter, section 3 of [Liu].

M maps the joint error at one time to the innovations of all later updates. It is recorded from the
Phi and H with which the filter propagates and updates its covariance.
"""

import numpy as np
from scipy.linalg import orth

from fej_slam_ros.core.ekf.covariance import (
    Correction, Covariance, Projection, Slot, SparseRows, Transport)
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.state import (
    JointState, observation_columns, pose_indices, position_indices)
from fej_slam_ros.core.ekf.symmetric_matrix import SymmetricMatrix
from fej_slam_ros.core.geometry import Array, perpendicular

#: Singular values above this fraction of the largest are nonzero; rounding leaves about 1e-16.
RANK_TOLERANCE = 1e-8


class ObservabilityRecorder(Covariance):
    """
    A covariance that records M.

    As the covariance of a filter it changes no bit of the estimate. All robots and landmarks must
    have been started before.

    Parameters
    ----------
    covariance : the initial covariance, which is copied

    """

    def __init__(self, covariance: Covariance) -> None:
        super().__init__(SymmetricMatrix(*covariance.matrix.packed()))
        #: (2 m, n) array per update of m accepted observations, H_k Phi_k-1 ... Phi_0, eq. (13)
        self.rows: list[Array] = []
        self._transition: Array = np.eye(self.dimension)
        self._proposed: Array = np.empty((0, self.dimension))

    def propagate(self, slot: Slot, Phi: Array, N: Array) -> None:
        """Multiply Phi_k-1 ... Phi_0 by Phi_k."""
        self._transition[slot.indices] = Phi @ self._transition[slot.indices]
        super().propagate(slot, Phi, N)

    def project(self, H: SparseRows, R: Array) -> Projection:
        """Prepare the rows of an update, which may still be gated or linearised again."""
        rows = np.einsum('mij,mjk->mik', H.blocks, self._transition[H.columns])
        self._proposed = rows.reshape(-1, self.dimension)
        return super().project(H, R)

    def condition(self, correction: Correction) -> None:
        """Record the rows of the update."""
        self.rows.append(self._proposed)
        super().condition(correction)

    def transport(self, A: Transport) -> None:
        """Multiply Phi_k-1 ... Phi_0 by A."""
        self._transition += A.V @ self._transition[A.columns]
        super().transport(A)


def record_observability(filter_: Filter) -> ObservabilityRecorder:
    """Record the observability matrix of a filter from now on; return its recorder."""
    recorder = ObservabilityRecorder(filter_.state.whole())
    filter_.state.covariance = recorder
    return recorder


def singular_values(M: Array) -> Array:
    """Return the singular values of M (m, n) relative to the largest, in descending order."""
    s = np.linalg.svd(M, compute_uv=False)
    relative: Array = s / s[0]
    return relative


def rank(M: Array) -> int:
    """Return the number of observable directions of the joint error (n,), given M (m, n)."""
    return int(np.count_nonzero(singular_values(M) > RANK_TOLERANCE))


def null_space(M: Array) -> Array:
    """Return an orthonormal basis (n, k) of the unobservable directions, given M (m, n)."""
    # R of M = Q R has the same null space and is much smaller.
    Vt = np.linalg.svd(np.linalg.qr(M, mode='r'))[2]
    return Vt[rank(M):].T


def rigid_motions(state: JointState, x: Array) -> Array:
    """
    Return the derivatives of the joint state by a rigid motion of the whole.

    Parameters
    ----------
    state : slots of robots and landmarks
    x : (n,) array, values of the joint state

    Returns
    -------
    (n, 3) array
        By the shifts along x and y [m] and the turn about the origin [rad].

    """
    positions = position_indices(state.variables())
    motions = np.zeros((len(x), 3))
    motions[positions, :2] = np.eye(2)
    motions[positions, 2] = perpendicular(x[positions])
    motions[state.headings(), 2] = 1.0
    return motions


def linearized_rigid_motions(filter_: Filter) -> Array:
    """Return `rigid_motions` (n, 3) at the points where the filter linearises observations."""
    state = filter_.state
    robots, landmarks = list(state.robots.values()), list(state.landmarks.values())
    linearized_at = filter_.linearization.observation_points
    poses = linearized_at(state, observation_columns(robots, robots))[:, :3]
    observers = [robots[0]] * len(landmarks)
    points = linearized_at(state, observation_columns(observers, landmarks))[:, 3:]
    x = np.empty_like(state.x_hat)
    x[pose_indices(robots)], x[position_indices(landmarks)] = poses, points
    return rigid_motions(state, x)


def largest_sine(a: Array, b: Array) -> float:
    """Return the largest sine of the angles of two column spaces (n, k); 1 if ranks differ."""
    Q_a, Q_b = orth(a), orth(b)
    return float(np.linalg.norm(Q_a @ Q_a.T - Q_b @ Q_b.T, 2))
