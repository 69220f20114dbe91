# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Storage of a symmetric matrix that grows and shrinks, for updates in place by BLAS.

Between two updates, robots are predicted many times. Only their diagonal blocks are computed each
time; what follows for the other elements is applied when they are next changed. Reading them
before changes no bit of any later result.
"""

from collections.abc import Iterable, Mapping
import math
from types import MappingProxyType

import numpy as np
from scipy.linalg.blas import dsyr2k

from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.pieces import PIECE_ELEMENTS, PIECE_FLOPS, ranges

#: Minimum number of rows by which the storage grows; large storage grows by a share of its rows.
GROWTH = 16
#: Maximum number of columns that are copied together, from the diagonal down.
COPIED_COLUMNS = 64

#: Propagations of a variable: the product of all Phi, and its diagonal block.
Propagated = tuple[Array, Array]


class SymmetricMatrix:
    """
    A symmetric matrix (n, n), of which only the lower triangle is read and written.

    It lies in a zero-padded Fortran array, because BLAS updates a whole array in place but never a
    slice of one.

    Parameters
    ----------
    capacity, triangle, propagated : as `packed` returns them

    """

    def __init__(
        self, capacity: int = GROWTH, triangle: Array | None = None,
        propagated: Mapping[int, Propagated] = MappingProxyType({}),
    ) -> None:
        columns = np.empty(0) if triangle is None else triangle
        n = self.dimension = (math.isqrt(8 * len(columns) + 1) - 1) // 2
        self._lower: Array = np.zeros((capacity, capacity), order='F')
        # Of variables propagated since the other elements were, by their first index.
        self._propagated = {**propagated}
        ends = np.cumsum(np.arange(n, 0, -1))
        for j, column in enumerate(np.split(columns, ends[:-1]) if n else ()):
            self._lower[j:n, j] = column

    @property
    def lower(self) -> Array:
        """Return the storage (capacity, capacity), with all propagations applied."""
        self.settle()
        return self._lower

    def copy(self) -> 'SymmetricMatrix':
        """Return an independent copy."""
        copied = SymmetricMatrix(0, propagated=self._propagated)
        copied.dimension, copied._lower = self.dimension, self._stored(len(self._lower))
        return copied

    def packed(self) -> tuple[int, Array, dict[int, Propagated]]:
        """
        Return the capacity, the lower triangle column by column, and the propagations to apply.

        The capacity counts because BLAS may round differently in a storage of another size.

        """
        n = self.dimension
        columns = [self._lower[j:n, j] for j in range(n)]
        return len(self._lower), np.concatenate([np.empty(0), *columns]), {**self._propagated}

    def propagate(self, start: int, Phi: Array, N: Array) -> None:
        """Apply a congruence by Phi (d, d) to the d states from start on, and add N (d, d)."""
        before, block = self._propagated.get(start) or (None, self.block(start, len(Phi)))
        self._propagated[start] = KERNEL.propagated(before, block, Phi, N)

    def settle(self) -> None:
        """Apply the propagations to all elements."""
        for start, (Phi, block) in self._propagated.items():
            KERNEL.settle(self._lower, self.dimension, start, Phi, block)
        self._propagated.clear()

    def block(self, start: int, size: int) -> Array:
        """Return the diagonal block of a variable, symmetric (size, size), not to be modified."""
        if start in self._propagated:
            return self._propagated[start][1]
        return KERNEL.diagonal_block(self._lower, start, size)

    def at(self, i: Indices, j: Indices) -> Array:
        """Return the elements in rows i and columns j, which broadcast."""
        P = self._elements(i, j)
        for start, (Phi, _) in self._propagated.items():
            of_i, of_j = (
                np.broadcast_to((start <= k) & (k < start + len(Phi)), P.shape) for k in (i, j))
            if of_i.any() or of_j.any():
                rows, columns = np.broadcast_arrays(i, j)
                P_v = self._propagated_columns(start)
                P[of_j] = P_v[rows[of_j], columns[of_j] - start]
                P[of_i] = P_v[columns[of_i], rows[of_i] - start]
        return P

    def _propagated_columns(self, start: int) -> Array:
        """Return the columns (n, d) of a propagated variable."""
        Phi, block = self._propagated[start]
        own = slice(start, start + len(Phi))
        states = np.arange(own.start, own.stop)
        P = KERNEL.columns(self._lower, states)[:self.dimension] @ Phi.T
        for other, (Phi_other, _) in self._propagated.items():
            rows = slice(other, other + len(Phi_other))
            P[rows] = Phi_other @ P[rows]
        P[own] = block
        return P

    def settled(self) -> 'SymmetricMatrix':
        """Return this matrix, or a copy, without propagations to apply."""
        if not self._propagated:
            return self
        copied = self.copy()
        copied.settle()
        return copied

    def submatrix(self, indices: Indices) -> Array:
        """Return the elements in rows and columns of the indices, a symmetric (k, k) array."""
        if not self._propagated:
            return self._elements(indices[:, None], indices)
        propagated = [start + np.arange(len(Phi)) for start, (Phi, _) in self._propagated.items()]
        states = np.unique(np.concatenate([indices, *propagated]))
        P = self._elements(states[:, None], states)
        for start, (Phi, block) in self._propagated.items():
            first = int(np.searchsorted(states, start))
            own = slice(first, first + len(Phi))
            P[own] = Phi.dot(P[own])
            P[:, own] = P[own].T
            P[own, own] = block
        places = np.searchsorted(states, indices)
        return P[places[:, None], places]

    def _elements(self, i: Indices, j: Indices) -> Array:
        """Return the elements in rows i and columns j, without the propagations."""
        elements: Array
        if i.size * j.size <= PIECE_ELEMENTS:
            elements = self._lower[np.maximum(i, j), np.minimum(i, j)]
            return elements
        i, j = np.broadcast_arrays(i, j)
        elements = np.empty(i.shape)
        for part in ranges(len(i), PIECE_ELEMENTS / i[0].size):
            elements[part] = self._lower[
                np.maximum(i[part], j[part]), np.minimum(i[part], j[part])]
        return elements

    def columns(self, indices: Indices) -> Array:
        """Return full columns, (capacity, k) in Fortran order, zero beyond row n."""
        return KERNEL.columns(self.lower, indices)

    def replace_columns(self, indices: Indices, full: Array) -> None:
        """Replace columns, and the rows of the same indices, by columns (capacity, k)."""
        self.settle()
        for part in ranges(len(indices), PIECE_ELEMENTS / len(full)):
            KERNEL.replace_columns(self._lower, indices[part], full[:, part])

    def subtract_product(self, W: Array) -> None:
        """Subtract W W^T of a Fortran array W, as a kernel does: k n^2 flops."""
        self.settle()
        n, rank = self.dimension, W.shape[1]
        if rank * n ** 2 <= PIECE_FLOPS:
            KERNEL.subtract_product(self._lower, W, n)
            return
        for part in ranges(rank, PIECE_FLOPS / n ** 2):
            KERNEL.subtract_product(self._lower, W[:, part], n)

    def append(self, size: int) -> int:
        """Add zero rows and columns; return the index of the first."""
        start = self.dimension
        self.dimension += size
        if self.dimension > len(self._lower):
            self._lower = self._stored(_grown(self.dimension))
        return start

    def reserve(self, sizes: Iterable[int]) -> None:
        """Grow the storage at once as far as it would grow by appending rows of the sizes."""
        dimension, capacity = self.dimension, len(self._lower)
        for size in sizes:
            dimension += size
            if dimension > capacity:
                capacity = _grown(dimension)
        if capacity > len(self._lower):
            self._lower = self._stored(capacity)

    def _stored(self, capacity: int) -> Array:
        """Return the elements in new storage, zero beyond the old one."""
        n = min(self.dimension, len(self._lower), capacity)
        stored = np.zeros((capacity, capacity), order='F')
        for part in ranges(n, min(PIECE_ELEMENTS / max(n, 1), COPIED_COLUMNS)):
            stored[part.start:n, part] = self._lower[part.start:n, part]
        return stored

    def remove(self, indices: Indices) -> None:
        """Delete the rows and columns of the indices, which are in order."""
        self.settle()
        n, first = self.dimension, int(indices[0])
        later = np.delete(np.arange(first, n), indices - first)
        k = self.dimension = first + len(later)
        # In place, since row and column numbers only decrease.
        for part in ranges(k, PIECE_ELEMENTS / max(len(later), 1)):
            columns = np.arange(part.start, part.stop)
            columns[columns >= first] = later[columns[columns >= first] - first]
            self._lower[first:k, part] = self._lower[later[:, None], columns]
        self._lower[k:n] = 0.0


def add_products(matrix: SymmetricMatrix, V: Array, B: Array) -> None:
    """Add V B^T + B V^T of arrays (capacity, k): 2 k n^2 flops."""
    lower = matrix.lower
    for part in ranges(V.shape[1], PIECE_FLOPS / max(2 * matrix.dimension ** 2, 1)):
        dsyr2k(1.0, V[:, part], B[:, part], beta=1.0, c=lower, lower=1, overwrite_c=1)


def _grown(dimension: int) -> int:
    """Return the capacity for a number of rows that exceeds the present one."""
    return dimension + max(GROWTH, int(KERNEL.STORAGE_GROWTH * dimension))
