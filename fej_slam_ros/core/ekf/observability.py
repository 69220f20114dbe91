# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What a filter believes that it can know: its local observability matrix M, section 3 of [Liu].

M maps the joint error at a moment to the innovations of all updates since. It is made of the very
Phi and H that the covariance is given, whatever the filter is.
"""

import numpy as np
from scipy.linalg import orth

from fej_slam_ros.core.ekf.covariance import (
    Correction, Covariance, Projection, Slot, SparseRows, Transport)
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.geometry import Array, perpendicular

#: Singular values above this part of the largest count: what should be zero is 1e-16 of it.
RELATIVE = 1e-8


class ObservabilityRecorder(Covariance):
    """
    A covariance that keeps the M of what it is told.

    Put in the place of a filter's covariance it changes no bit of the estimate. All robots and
    landmarks must have been started before.

    Parameters
    ----------
    covariance : what it begins with

    Attributes
    ----------
    rows : (2 m, n) array of each update with m observations, H_k Phi_k-1 ... Phi_0 of eq. (13); those
        of observations that the gate refused are not among them

    """

    def __init__(self, covariance: Covariance) -> None:
        super().__init__()
        self.unpack(*covariance.packed())
        self.rows: list[Array] = []
        self._transition: Array = np.eye(self.dimension)
        self._proposed: Array = np.empty((0, self.dimension))

    def propagate(self, slot: Slot, Phi: Array, N: Array) -> None:
        """Multiply the rows of Phi_k-1 ... Phi_0 by Phi_k."""
        self._transition[slot.indices] = Phi @ self._transition[slot.indices]
        super().propagate(slot, Phi, N)

    def project(self, H: SparseRows, R: Array) -> Projection:
        """Form the rows of an update that may still be refused, or linearised again."""
        rows = np.einsum('mij,mjk->mik', H.blocks, self._transition[H.columns])
        self._proposed = rows.reshape(-1, self.dimension)
        return super().project(H, R)

    def condition(self, correction: Correction) -> None:
        """Keep the rows: the update takes place."""
        self.rows.append(self._proposed)
        super().condition(correction)

    def transport(self, A: Transport) -> None:
        """Let the errors after an update go over into others."""
        self._transition += A.V @ self._transition[A.columns]
        super().transport(A)


def singular_values(M: Array) -> Array:
    """Return the singular values of M, relative to the largest and in falling order."""
    s = np.linalg.svd(M, compute_uv=False)
    relative: Array = s / s[0]
    return relative


def rank(M: Array) -> int:
    """Return how many directions of the joint error the updates have told of."""
    return int(np.count_nonzero(singular_values(M) > RELATIVE))


def null_space(M: Array) -> Array:
    """Return the directions (n, k) of the joint error that no update has told of, orthonormal."""
    # The triangle has the null space of M and spares the SVD a basis as large as M is tall.
    Vt = np.linalg.svd(np.linalg.qr(M, mode='r'))[2]
    unknown: Array = Vt[rank(M):].T
    return unknown


def rigid_motions(state: JointState, x: Array) -> Array:
    """
    Return how the joint state changes when everything moves: by x, by y, and turns.

    Parameters
    ----------
    state : where robots and landmarks have their slots
    x : (n,) array, what turns about the origin

    Returns
    -------
    (n, 3) array
        Derivatives of the moved x by the shift along x [m], that along y [m] and the turn [rad].

    """
    positions = state.positions(state.variables())
    motions = np.zeros((len(x), 3))
    motions[positions, :2] = np.eye(2)
    motions[positions, 2] = perpendicular(x[positions])
    motions[state.headings(), 2] = 1.0
    return motions


def largest_sine(a: Array, b: Array) -> float:
    """Return that of the principal angles of two subspaces given by columns; 1 if sizes differ."""
    Q_a, Q_b = orth(a), orth(b)
    return float(np.linalg.norm(Q_a @ Q_a.T - Q_b @ Q_b.T, 2))
