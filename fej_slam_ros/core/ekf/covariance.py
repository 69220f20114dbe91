# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The joint covariance P of robots and landmarks: prediction, augmentation, update, removal.

Costs are in flops for n states and m observations that touch k states. No Jacobian is as wide as
the state, so an update costs little more than its rank-2m update of one triangle of P, 2 m n^2.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.symmetric_matrix import add_products, SymmetricMatrix
from fej_slam_ros.core.geometry import Array, Indices


@dataclass(slots=True, eq=False)
class Slot:
    """Indices of one variable's states in the joint vector."""

    start: int
    size: int

    @property
    def stop(self) -> int:
        """Return the index after the last state of the variable."""
        return self.start + self.size

    @property
    def indices(self) -> Indices:
        """Return the indices of the variable's states, a (size,) array."""
        return np.arange(self.start, self.stop)

    def split(self, sizes: Sequence[int]) -> 'list[Slot]':
        """Return the slots of variables of the given sizes that lie in this one, in order."""
        return list(map(Slot, accumulate(sizes, initial=self.start), sizes))


class SparseRows(NamedTuple):
    """A measurement Jacobian H without its zeros, two rows per observation."""

    columns: Indices  #: (m, d) array, the d states that each of the m observations depends on
    blocks: Array  #: (m, 2, d) array, the Jacobian with respect to those states

    def of(self, dx: Array) -> Array:
        """Return H dx (2 m,) of a joint error (n,)."""
        predicted: Array = np.einsum('mij,mj->mi', self.blocks, dx[self.columns]).ravel()
        return predicted

    def after(self, A: 'Transport') -> 'SparseRows':
        """Return H A."""
        (m, d), k = self.columns.shape, len(A.columns)
        columns, blocks = np.empty((m, d + k), np.intp), np.empty((m, 2, d + k))
        columns[:, :d], columns[:, d:] = self.columns, A.columns
        blocks[:, :, :d] = self.blocks
        np.einsum('mij,mjk->mik', self.blocks, A.V[self.columns], out=blocks[:, :, d:])
        return SparseRows(columns, blocks)


@dataclass(frozen=True, slots=True, eq=False)
class Transport:
    """A = I + V E^T, a change of the error coordinates."""

    columns: Indices  #: (k,) array, the states that E selects
    V: Array  #: (n, k) array
    #: (n,) array, the correction from the prior to the present estimate, headings not wrapped
    dx: Array
    #: function from an owner of points to the index of the heading that they turn with
    heading_of: Callable[[str], int | None]


class Projection(NamedTuple):
    """The prior as seen by the observations of an update."""

    #: (rows, k) Fortran array, the columns of the k states that are touched, with at least n rows
    P: Array
    H: Array  #: (2 m, k) array, the Jacobian with respect to these
    S: Array  #: (2 m, 2 m) array, H P H^T + R; only its lower triangle is used
    own: Array  #: (m, 2, 2) array, the diagonal blocks of S


class Correction(NamedTuple):
    """The Kalman update in factored form, K = W L^-1 with S = L L^T."""

    dx: Array  #: (n,) array, the correction K r = W y
    y: Array  #: (2 m,) array, the whitened innovation L^-1 r
    #: (rows, 2 m) Fortran array, P H^T L^-T, so that K S K^T = W W^T, with at least n rows
    W: Array
    log_det: float  #: log det S


class Covariance:
    """Joint covariance of errors in plain coordinates, (x, y, phi) and (x, y)."""

    def __init__(self, matrix: SymmetricMatrix | None = None) -> None:
        self.matrix = matrix or SymmetricMatrix()
        #: Number of updates before a submap is looked for again, where there was none
        self.updates_without_submap = 0

    def __copy__(self) -> 'Covariance':
        return Covariance(self.matrix.copy())

    @property
    def dimension(self) -> int:
        """Return n, the number of states."""
        return self.matrix.dimension

    @property
    def matrices(self) -> Sequence[SymmetricMatrix]:
        """Return what is stored, last the matrix that an update changes."""
        return [self.matrix]

    def marginal(self, slots: Sequence[Slot]) -> Array:
        """Return the symmetric joint covariance (k, k) of the variables, not to be modified."""
        if len(slots) == 1:
            return self.matrix.block(slots[0].start, slots[0].size)
        return self.matrix.submatrix(joint_indices(slots))

    def blocks(self, indices: Indices) -> Array:
        """Return the covariances (k, d, d) of k groups of d states, given by indices (k, d)."""
        return self.matrix.at(indices[:, :, None], indices[:, None, :])

    def variance_bounds(self, indices: Indices) -> Array:
        """Return upper bounds (k,) of the traces of `blocks`: the traces themselves."""
        traces: Array = self.matrix.at(indices, indices).sum(axis=1)
        return traces

    def current_estimates(self, x: Array, indices: Indices) -> Array:
        """Return estimates x of the states `indices` with all corrections, which they have."""
        return x

    def leave(self, x_hat: Array, may_end: bool = False) -> 'tuple[Covariance, Array]':
        """Return the covariance and the estimate (n,) of all states."""
        return self, x_hat

    def insert(self, P: Array) -> Slot:
        """Add states with covariance P (d, d), independent of all others."""
        slot = Slot(self.matrix.append(len(P)), len(P))
        self.matrix.lower[slot.start:slot.stop, slot.start:slot.stop] = P
        return slot

    def augment(self, parent: Slot, F: Array, N: Array) -> Slot:
        """Add a variable with error F (d, parent size) times its parent's plus noise N (d, d)."""
        n = self.dimension
        cross = F @ self.matrix.columns(parent.indices)[:n].T
        slot = self.insert(cross[:, parent.indices] @ F.T + N)
        self.matrix.lower[slot.start:slot.stop, :n] = cross
        return slot

    def remove(self, slots: Sequence[Slot], others: Iterable[Slot]) -> None:
        """Marginalise variables out; `others` are the slots of all others, which move up."""
        removed = np.sort(joint_indices(slots))
        self.matrix.remove(removed)
        for other in others:
            if other.start > removed[0]:
                other.start -= int(np.searchsorted(removed, other.start))

    def propagate(self, slot: Slot, Phi: Array, N: Array) -> None:
        """Apply P <- Phi P Phi^T + N, eq. (4), to a variable of d states: 2 d^2 n flops."""
        self.matrix.propagate(slot.start, Phi, N)

    def project(self, H: SparseRows, R: Array) -> Projection:
        """Return S = H P H^T + R and its parts for noise R (m, 2, 2): 4 m k^2 + 8 m^2 k flops."""
        return Projection(*KERNEL.project(
            self.matrix.lower, self.dimension, H.columns, H.blocks, R))

    def correction(self, prior: Projection, r: Array) -> Correction:
        """
        Return the gain in factored form and K r for residuals r (2 m,); P stays as it is.

        Raises
        ------
        ArithmeticError
            If S is not positive definite: the filter's own covariance is broken.

        """
        return Correction(*KERNEL.correction(prior.P, prior.H, prior.S, r, self.dimension))

    def condition(self, correction: Correction) -> None:
        """Apply P <- P - K S K^T = P - W W^T: 2 m n^2 flops."""
        self.matrix.subtract_product(correction.W)

    def transport(self, A: Transport) -> None:
        """Apply P <- A P A^T for k columns of V: 2 k n^2 flops."""
        PE = self.matrix.columns(A.columns)
        V = np.zeros_like(PE)
        V[:self.dimension] = A.V
        # A P A^T = P + V B^T + B V^T with B = P E + 1/2 V E^T P E.
        B = PE + 0.5 * V @ PE[A.columns]
        add_products(self.matrix, V, B)


def joint_indices(slots: Sequence[Slot]) -> Indices:
    """Return the indices (k,) of all states of the variables, in the order given."""
    return np.concatenate([np.empty(0, np.intp), *(slot.indices for slot in slots)])
