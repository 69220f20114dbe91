# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Storage of a symmetric matrix that grows and shrinks, for updates in place by BLAS."""

from collections.abc import Iterable
import math

import numpy as np
from scipy.linalg.blas import dsyrk

from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.pieces import PIECE_ELEMENTS, PIECE_FLOPS, ranges

#: Minimum number of rows by which the storage grows; beyond 500 rows it grows by 3 %.
GROWTH = 16


class SymmetricMatrix:
    """
    A symmetric matrix (n, n), of which only the lower triangle is read and written.

    It lies in a zero-padded Fortran array, because BLAS updates a whole array in place but never a
    slice of one.

    Parameters
    ----------
    capacity, triangle : as `packed` returns them

    """

    def __init__(self, capacity: int = GROWTH, triangle: Array | None = None) -> None:
        columns = np.empty(0) if triangle is None else triangle
        n = self.dimension = (math.isqrt(8 * len(columns) + 1) - 1) // 2
        self.lower: Array = np.zeros((capacity, capacity), order='F')  #: the storage
        ends = np.cumsum(np.arange(n, 0, -1))
        for j, column in enumerate(np.split(columns, ends[:-1]) if n else ()):
            self.lower[j:n, j] = column

    def copy(self) -> 'SymmetricMatrix':
        """Return an independent copy."""
        copied = SymmetricMatrix(0)
        copied.dimension, copied.lower = self.dimension, self._stored(len(self.lower))
        return copied

    def packed(self) -> tuple[int, Array]:
        """
        Return the capacity and the lower triangle, column by column.

        The capacity counts because BLAS may round differently in a storage of another size.

        """
        n = self.dimension
        columns = [self.lower[j:n, j] for j in range(n)]
        return len(self.lower), np.concatenate([np.empty(0), *columns])

    def at(self, i: Indices, j: Indices) -> Array:
        """Return the elements in rows i and columns j, which broadcast."""
        return self.lower[np.maximum(i, j), np.minimum(i, j)]

    def submatrix(self, indices: Indices) -> Array:
        """Return the elements in rows and columns of the indices, symmetric."""
        k = len(indices)
        elements = np.empty((k, k))
        for part in ranges(k, PIECE_ELEMENTS / max(k, 1)):
            elements[part] = self.at(indices[part, None], indices)
        return elements

    def columns(self, indices: Indices) -> Array:
        """Return full columns, (capacity, k) in Fortran order, zero beyond row n."""
        count, capacity = len(indices), len(self.lower)
        if count * capacity <= PIECE_ELEMENTS:
            return self._columns(indices)
        full = np.empty((capacity, count), order='F')
        for part in ranges(count, PIECE_ELEMENTS / capacity):
            full[:, part] = self._columns(indices[part])
        return full

    def _columns(self, indices: Indices) -> Array:
        full = self.lower.T.take(indices, 0).T
        for k, j in enumerate(indices.tolist()):
            full[:j, k] = self.lower[j, :j]
        return full

    def replace_columns(self, indices: Indices, full: Array) -> None:
        """Replace columns, and the rows of the same indices, by columns (capacity, k)."""
        for k, j in enumerate(indices.tolist()):
            self.lower[j:, j] = full[j:, k]
            self.lower[j, :j] = full[:j, k]

    def subtract_product(self, W: Array) -> None:
        """Subtract W W^T of a Fortran array W (capacity, k), zero beyond row n: k n^2 flops."""
        for part in ranges(W.shape[1], PIECE_FLOPS / max(self.dimension, 1) ** 2):
            self.lower = dsyrk(
                -1.0, W[:, part], beta=1.0, c=self.lower, lower=1, overwrite_c=1)

    def append(self, size: int) -> int:
        """Add zero rows and columns; return the index of the first."""
        start = self.dimension
        self.dimension += size
        if self.dimension > len(self.lower):
            self.lower = self._stored(_grown(self.dimension))
        return start

    def reserve(self, sizes: Iterable[int]) -> None:
        """Grow the storage at once as far as it would grow by appending rows of the sizes."""
        dimension, capacity = self.dimension, len(self.lower)
        for size in sizes:
            dimension += size
            if dimension > capacity:
                capacity = _grown(dimension)
        if capacity > len(self.lower):
            self.lower = self._stored(capacity)

    def _stored(self, capacity: int) -> Array:
        """Return the elements in new storage, zero beyond the old one."""
        n = min(len(self.lower), capacity)
        stored = np.zeros((capacity, capacity), order='F')
        for part in ranges(n, PIECE_ELEMENTS / max(n, 1)):
            stored[:n, part] = self.lower[:n, part]
        return stored

    def keep(self, indices: Indices) -> None:
        """Delete all rows and columns but those of the indices."""
        n, k = self.dimension, len(indices)
        self.dimension = k
        # In place: row and column numbers only decrease.
        for part in ranges(k, PIECE_ELEMENTS / max(k, 1)):
            self.lower[:k, part] = self.lower[indices[:, None], indices[part]]
        self.lower[k:n] = 0.0


def _grown(dimension: int) -> int:
    """Return the capacity for a number of rows that exceeds the present one."""
    return dimension + max(GROWTH, dimension * 3 // 100)
