# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
All bookkeeping of the joint covariance, behind slot handles.

Only the lower triangle is used, so the covariance is symmetric by construction; it lies in a
zero-padded Fortran array because BLAS works in place on a whole array only, never on a slice.
No Jacobian is ever as wide as the state: an observation touches the columns of its own variables. An
update costs little more than its rank-2m update of one triangle, which is the least there is.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math

import numpy as np
from scipy.linalg.blas import dgemm, dsyr2k, dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from fej_slam_ros.core.geometry import Array, Indices

#: The storage grows by this many states, or by 3 % where that is more.
GROWTH = 16

#: Which elements of a triangle are the whole of a pose's block on the diagonal; the first two rows
#: and columns are those of a position.
WHOLE = np.array([[0, 1, 2], [1, 1, 2], [2, 2, 2]]), np.array([[0, 0, 0], [0, 1, 1], [0, 1, 2]])



@dataclass(slots=True, eq=False)
class Slot:
    """Handle of one variable: its place in the joint vector."""

    start: int
    size: int

    @property
    def stop(self) -> int:
        """Return the index after the last state of the variable."""
        return self.start + self.size

    @property
    def indices(self) -> Indices:
        """Return the indices of the variable's states."""
        return np.arange(self.start, self.stop)


@dataclass(frozen=True, slots=True, eq=False)
class SparseRows:
    """
    A measurement Jacobian, two rows an observation, without its zeros.

    Attributes
    ----------
    columns : (m, k) array, the k states that each of the m observations depends on
    blocks : (m, 2, k) array, the Jacobian by those states

    """

    columns: Indices
    blocks: Array

    def of(self, dx: Array) -> Array:
        """Return H dx (2 m,) of a joint error (n,)."""
        predicted: Array = np.einsum('mij,mj->mi', self.blocks, dx[self.columns]).ravel()
        return predicted

    def compact(self, n: int) -> tuple[Indices, Array]:
        """Return which of n states there are, in order, and the Jacobian (2 m, k) by these."""
        m, named = len(self.columns), np.zeros(n, np.bool_)
        named[self.columns] = True
        states = np.flatnonzero(named)
        k, place = len(states), np.empty(n, np.intp)
        place[states] = np.arange(k)
        # A state may be named twice in a row: what is there is added up.
        cells = place[self.columns][:, None] + k * np.arange(2 * m).reshape(m, 2, 1)
        entries = np.bincount(cells.ravel(), self.blocks.ravel(), 2 * m * k)
        return states, entries.reshape(2 * m, k).astype(np.float64, copy=False)

    def after(self, A: 'Transport') -> 'SparseRows':
        """Return H A."""
        added = np.einsum('mij,mjk->mik', self.blocks, A.V[self.columns])
        columns = np.broadcast_to(A.columns, (len(self.columns), len(A.columns)))
        return SparseRows(np.hstack([self.columns, columns]), np.dstack([self.blocks, added]))


@dataclass(frozen=True, slots=True, eq=False)
class Transport:
    """
    A = I + V E^T, by which errors of the joint state go over into others.

    Attributes
    ----------
    columns : (k,) array, the states that E picks
    V : (n, k) array

    """

    columns: Indices
    V: Array


@dataclass(frozen=True, slots=True, eq=False)
class Projection:
    """
    What an update needs to know of the prior.

    Attributes
    ----------
    P : (capacity, k) Fortran array, the columns of the k states that observations depend on
    H : (2 m, k) array, the Jacobian by these
    S : (2 m, 2 m) array, H P H^T + R; only its lower triangle is used

    """

    P: Array
    H: Array
    S: Array


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """
    What observations say of the joint state.

    Attributes
    ----------
    dx : (n,) array, the correction K r
    y : (2 m,) array, the innovation whitened by the Cholesky factor of S
    W : (capacity, 2 m) Fortran array, of which P loses W W^T
    log_det : log det S

    """

    dx: Array
    y: Array
    W: Array
    log_det: float


class Covariance:
    """Joint covariance of robots and landmarks, in plain coordinates (x, y, phi) and (x, y)."""

    def __init__(self) -> None:
        self.dimension = 0
        self._lower: Array = np.zeros((GROWTH, GROWTH), order='F')

    def unpack(self, capacity: int, triangle: Array) -> None:
        """Hold what `packed` gave of another covariance."""
        n = self.dimension = (math.isqrt(8 * len(triangle) + 1) - 1) // 2
        self._lower = np.zeros((capacity, capacity), order='F')
        ends = np.cumsum(np.arange(n, 0, -1))
        for j, column in enumerate(np.split(triangle, ends[:-1]) if n else ()):
            self._lower[j:n, j] = column

    def packed(self) -> tuple[int, Array]:
        """
        Return the size of the storage and the lower triangle, column by column.

        BLAS may round differently in a storage of another size.

        """
        n = self.dimension
        columns = [self._lower[j:n, j] for j in range(n)]
        return len(self._lower), np.concatenate([np.empty(0), *columns])

    def marginal(self, slots: Sequence[Slot]) -> Array:
        """Return the symmetric joint covariance of the variables, in the order given."""
        if len(slots) == 1:
            return self._block(slots[0])
        return self.at(joint_indices(slots), joint_indices(slots))

    def cross(self, a: Sequence[Slot], b: Sequence[Slot]) -> Array:
        """Return the cross-covariance of the variables a (rows) and b (columns)."""
        return self.at(joint_indices(a), joint_indices(b))

    def blocks(self, indices: Indices) -> Array:
        """Return the covariances (k, d, d) of d states each, given by their indices (k, d)."""
        i, j = indices[:, :, None], indices[:, None, :]
        return self._lower[np.maximum(i, j), np.minimum(i, j)]

    def insert(self, P: Array) -> Slot:
        """Add a variable with covariance P, independent of all others."""
        slot = self._append(len(P))
        self._lower[slot.start:slot.stop, slot.start:slot.stop] = P
        return slot

    def insert_joint(self, P: Array, sizes: Sequence[int]) -> list[Slot]:
        """Fill an empty covariance with P (n, n) of variables of the given sizes, in order."""
        whole = self._append(len(P))
        self._lower[whole.start:whole.stop, whole.start:whole.stop] = P
        starts = np.cumsum([0, *sizes])
        return [Slot(int(start), size) for start, size in zip(starts, sizes)]

    def augment(self, parent: Slot, F: Array, N: Array) -> Slot:
        """Add a variable that is F (k, parent size) times its parent plus noise N (k, k)."""
        n = self.dimension
        cross = F @ self.columns(parent.indices)[:n].T
        slot = self._append(len(F))
        self._lower[slot.start:slot.stop, :n] = cross
        self._lower[slot.start:slot.stop, slot.start:slot.stop] = (
            cross[:, parent.indices] @ F.T + N)
        return slot

    def remove(self, slots: Sequence[Slot], others: Iterable[Slot]) -> None:
        """
        Marginalise variables out; the others keep all that is known of them.

        Parameters
        ----------
        slots : of the variables that go
        others : of all others, which move up

        """
        n, gone = self.dimension, joint_indices(slots)
        left = np.delete(np.arange(n), gone)
        self.dimension = len(left)
        self._lower[:len(left), :len(left)] = self._lower[np.ix_(left, left)]
        self._lower[len(left):n] = 0.0
        for slot in others:
            slot.start -= int(np.count_nonzero(gone < slot.start))

    def propagate(self, slot: Slot, Phi: Array, N: Array) -> None:
        """Move one variable by the transition Phi with noise N; all others stand still."""
        start, stop, n = slot.start, slot.stop, self.dimension
        before, beside = self._lower[start:stop, :start], self._lower[stop:n, start:stop]
        own = Phi.dot(self._block(slot)).dot(Phi.T) + N
        before[:] = Phi.dot(before)
        beside[:] = beside @ Phi.T
        self._lower[start:stop, start:stop] = own

    def project(self, H: SparseRows, R: Array) -> Projection:
        """Return what an update needs by observations with the noise R (m, 2, 2)."""
        columns, compact = H.compact(self.dimension)
        P = self.columns(columns)
        S = compact.dot(P[columns]).dot(compact.T)
        m = len(R)
        own_blocks = np.einsum('iaib->iab', S.reshape(m, 2, m, 2))
        own_blocks += R
        return Projection(P, compact, S)

    def correction(self, prior: Projection, r: Array) -> Correction:
        """
        Return what observations with innovation r (2 m,) say; `condition` lets P know.

        Raises
        ------
        ArithmeticError
            If S is not positive definite: the filter's own covariance is broken.

        """
        L, failed_at = dpotrf(prior.S, lower=1)
        if failed_at:
            raise ArithmeticError(f'innovation covariance not positive definite at {failed_at}')
        # W = P H^T L^-T, but nothing as long as the state is solved for.
        W = dgemm(1.0, prior.P, dtrsm(1.0, L, prior.H, lower=1), trans_b=1)
        y: Array = dtrsv(L, r, lower=1)
        log_det = 2.0 * sum(map(math.log, L.diagonal().tolist()))
        return Correction(W[:self.dimension] @ y, y, W, log_det)

    def condition(self, correction: Correction) -> None:
        """Apply P <- P - P H^T S^-1 H P."""
        self.reduce(correction.W)

    def reduce(self, W: Array) -> None:
        """Apply P <- P - W W^T for a Fortran array W (capacity, k), zero beyond the state."""
        self._lower = dsyrk(-1.0, W, beta=1.0, c=self._lower, lower=1, overwrite_c=1)

    def transport(self, A: Transport) -> None:
        """Apply P <- A P A^T."""
        PE = self.columns(A.columns)
        padded = np.zeros_like(PE)
        padded[:self.dimension] = A.V
        half = PE + 0.5 * padded @ PE[A.columns]
        self._lower = dsyr2k(
            1.0, np.asfortranarray(padded), np.asfortranarray(half),
            beta=1.0, c=self._lower, lower=1, overwrite_c=1)

    def at(self, rows: Indices, columns: Indices) -> Array:
        """Return the elements of P (r, c) in some rows and columns."""
        i, j = rows[:, None], columns[None, :]
        return self._lower[np.maximum(i, j), np.minimum(i, j)]

    def columns(self, indices: Indices) -> Array:
        """Return full columns of P, (capacity, k) in Fortran order, zero beyond the state."""
        full = self._lower.T.take(indices, 0).T
        for k, j in enumerate(indices.tolist()):
            full[:j, k] = self._lower[j, :j]
        return full

    def replace_columns(self, indices: Indices, full: Array) -> None:
        """Replace columns, and with them rows, of P by others as `columns` returns them."""
        for k, j in enumerate(indices.tolist()):
            self._lower[j:, j] = full[j:, k]
            self._lower[j, :j] = full[:j, k]

    def _block(self, slot: Slot) -> Array:
        i, j = WHOLE
        block = self._lower[slot.start:slot.stop, slot.start:slot.stop]
        whole: Array = block[i[:slot.size, :slot.size], j[:slot.size, :slot.size]]
        return whole

    def _append(self, size: int) -> Slot:
        slot = Slot(self.dimension, size)
        self.dimension += size
        if self.dimension > len(self._lower):
            capacity = self.dimension + max(GROWTH, self.dimension * 3 // 100)
            grown = np.zeros((capacity, capacity), order='F')
            grown[:slot.start, :slot.start] = self._lower[:slot.start, :slot.start]
            self._lower = grown
        return slot


def joint_indices(slots: Sequence[Slot]) -> Indices:
    """Return the indices of all states of the variables, in the order given."""
    return np.concatenate([slot.indices for slot in slots])
