# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Sparse normal equations of pairwise measurements of poses and landmarks, and their Cholesky factor.

Poses and landmarks are the nodes of a graph with an edge for each measurement. The elimination
order is computed on this graph, which is smaller than that of the coordinates, once for all
matrices of one pattern; so are the positions in A^T A, eq. (2) of [Andersson], of the products of
each whitened Jacobian.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import solve_triangular
from scipy.sparse import csc_array, dia_array
from scipy.sparse.linalg import splu, SuperLU

from fej_slam_ros.core.gauss_newton import SingularError
from fej_slam_ros.core.geometry import Array, distinct, Indices, runs, starts_of
from fej_slam_ros.core.smoothing.inverse_blocks import inverse_blocks, InverseBlocks

#: Smallest ratio of a pivot to its diagonal entry; below it the pivot is a rounded zero.
MIN_PIVOT_RATIO = 1e-13
#: The two nodes (k,) of each of k measurements, by kind of measurement.
Links = Sequence[tuple[Indices, Indices]]

UNDETERMINED = (
    'the measurements do not determine all poses and landmarks, or odometry is nearly exact, so'
    ' that rounding hides the others')


class NormalEquations:
    """
    Assembly of A^T A from whitened Jacobians, in an elimination order of little fill.

    Attributes
    ----------
    coordinates : (u,) array, coordinate of each unknown, in the order of elimination;
        coordinates are counted node by node

    """

    def __init__(self, sizes: Indices, free: Indices, links: Links) -> None:
        """
        Find the order and the pattern.

        Parameters
        ----------
        sizes : (n,) array, number of coordinates of each node
        free : indices of the nodes that are solved for; the others are fixed
        links : at least one kind; the two nodes of a measurement differ, and all nodes of one side
            have one size

        """
        order = _elimination_order(len(sizes), free, links)
        rank = np.full(len(sizes), -1)
        rank[order] = np.arange(len(order))
        self._pattern = _BlockPattern(sizes[order], *_linked(links, rank))
        starts = starts_of(sizes)
        self.coordinates = runs(starts[order], sizes[order])
        # Sums of fixed coordinates have the index u, those of fixed blocks e: they are left out.
        unknown = np.full(sizes.sum(), len(self.coordinates))
        unknown[self.coordinates] = np.arange(len(self.coordinates))
        self._unknowns = [
            unknown[np.hstack([
                starts[end][:, None] + np.arange(sizes[end[0]]) for end in ends])]
            for ends in links]
        self._positions = [
            np.block([[
                self._pattern.positions(rank[a], rank[b], sizes[a[0]], sizes[b[0]])
                for b in ends] for a in ends])
            for ends in links]

    def matrix(self, blocks: Sequence[Array]) -> csc_array:
        """Return A^T A (u, u) from the whitened Jacobians (k, d, c) of each kind."""
        data = np.zeros(len(self._pattern.rows) + 1)
        for A, positions in zip(blocks, self._positions):
            data += np.bincount(
                positions.ravel(), (A.transpose(0, 2, 1) @ A).ravel(), minlength=len(data))
        u = len(self.coordinates)
        return csc_array(
            (data[:-1], self._pattern.rows, self._pattern.columns), shape=(u, u))

    def right_side(self, blocks: Sequence[Array], residuals: Sequence[Array]) -> Array:
        """Return A^T b (u,) from the Jacobians (k, d, c) and residuals (k, d) of each kind."""
        g = np.zeros(len(self.coordinates) + 1)
        for A, b, unknowns in zip(blocks, residuals, self._unknowns):
            g += np.bincount(
                unknowns.ravel(), np.einsum('kdc,kd->kc', A, b).ravel(), minlength=len(g))
        return g[:-1]


class _BlockPattern:
    """
    Compressed columns of a symmetric matrix with a dense block for each pair of linked nodes.

    All columns of a node have the same rows: its own, and those of the nodes it is linked to.

    Attributes
    ----------
    rows : (e,) array, row of each element, column by column
    columns : (u + 1,) array, position of the first element of each column, and e

    """

    def __init__(self, sizes: Indices, a: Indices, b: Indices) -> None:
        """Lay out nodes of some sizes (m,), and the links between nodes a and b (k,)."""
        m = len(sizes)
        # One key for each block, sorted by the node of its columns, then by that of its rows.
        self._keys = distinct(np.concatenate([np.arange(m) * (m + 1), a * m + b, b * m + a]))
        column, row = np.divmod(self._keys, m)
        block_heights = sizes[row]
        # By node: number of elements in each of its columns, and position of the first.
        self._heights = np.bincount(column, block_heights, minlength=m).astype(np.intp)
        self._firsts = starts_of(self._heights * sizes)
        first_rows = starts_of(self._heights)
        # By block: number of elements above it in each of its columns.
        self._above = starts_of(block_heights) - first_rows[column]
        heights = np.repeat(self._heights, sizes)
        self.columns = np.concatenate([[0], np.cumsum(heights)])
        rows_of_nodes = runs(starts_of(sizes)[row], block_heights)
        self.rows = rows_of_nodes[runs(np.repeat(first_rows, sizes), heights)]

    def positions(self, i: Indices, j: Indices, height: int, width: int) -> Indices:
        """
        Return where the elements of k blocks are, a (k, height, width) array.

        A block has the rows of node i and the columns of node j, (k,) arrays. The position is e if
        one of the two is -1, a node that is not in the matrix.

        """
        block = np.minimum(
            np.searchsorted(self._keys, j * len(self._heights) + i), len(self._keys) - 1)
        first = self._firsts[j] + self._above[block]
        down, right = np.arange(height), np.arange(width)
        positions: Indices = (
            first[:, None, None] + down[:, None] + self._heights[j][:, None, None] * right)
        positions[(i < 0) | (j < 0)] = len(self.rows)
        return positions


class Cholesky:
    """Factorisation of a symmetric positive definite matrix (u, u) without reordering."""

    def __init__(self, matrix: csc_array) -> None:
        """Factor the matrix; raise SingularError if it is not numerically definite."""
        try:
            self._factors = _factored(matrix, 'NATURAL')
        except RuntimeError:
            raise SingularError(UNDETERMINED) from None
        self._matrix = matrix
        self._pivots: Array = self._factors.U.diagonal()
        if not np.all(self._pivots[self._factors.perm_c] > MIN_PIVOT_RATIO * matrix.diagonal()):
            raise SingularError(UNDETERMINED)
        #: (u,) array, row of the matrix at each row of the factor
        self.order: Indices = np.argsort(self._factors.perm_c)

    def solve(self, right: Array) -> Array:
        """Return matrix^-1 right for a right side (u,) or (u, k)."""
        x: Array = self._factors.solve(right)
        return x

    def square_root(self) -> csc_array:
        """Return the upper triangular R_sqrt, with columns in the order of the factor."""
        return (diagonal(1.0 / np.sqrt(self._pivots)) @ self._factors.U).tocsc()

    def inverse_at(self, rows: Indices) -> Array:
        """
        Return the inverse in some rows and the same columns.

        With L D L^T = matrix it is Y^T D^-1 Y, where L Y are unit columns. Y is not zero only in
        the rows that elimination reaches from these, of which there are few.

        """
        if not len(rows):
            # solve_triangular of scipy 1.11 rejects a matrix without rows.
            return np.zeros((0, 0))
        L: csc_array = self._factors.L.tocsc()
        wanted = self._factors.perm_c[rows]
        is_reached = np.zeros(len(self._pivots), bool)
        is_reached[wanted] = True
        for j in range(wanted.min(initial=len(is_reached)), len(is_reached)):
            if is_reached[j]:
                is_reached[L.indices[L.indptr[j]:L.indptr[j + 1]]] = True
        reached = np.flatnonzero(is_reached)
        unit = np.zeros((len(reached), len(rows)), order='F')
        unit[np.searchsorted(reached, wanted), np.arange(len(rows))] = 1.0
        Y = solve_triangular(
            L[:, reached][reached].toarray(order='F'), unit, lower=True, unit_diagonal=True,
            overwrite_b=True, check_finite=False)
        Y /= np.sqrt(self._pivots[reached])[:, None]
        inverse: Array = Y.T @ Y
        return inverse

    def inverse_blocks(self, sizes: Indices) -> Iterator[InverseBlocks]:
        """Yield blocks of the inverse; `sizes` are those of the blocks in the factor's order."""
        pattern = self._matrix[:, self.order][self.order]
        return inverse_blocks(self._factors.L.tocsc(), self._pivots, pattern, sizes)


def _elimination_order(count: int, free: Indices, links: Links) -> Indices:
    """Return the free nodes in minimum-degree order."""
    rank = np.full(count, -1)
    rank[free] = np.arange(len(free))
    a, b = _linked(links, rank)
    # Diagonal dominance prevents pivoting, so that only the pattern decides.
    degree = 1.0 + 2.0 * np.bincount(np.concatenate([a, b]), minlength=len(free))
    nodes = np.arange(len(free))
    data = np.concatenate([degree, np.full(2 * len(a), -1.0)])
    rows, columns = np.concatenate([nodes, a, b]), np.concatenate([nodes, b, a])
    graph = csc_array((data, (rows, columns)), shape=(len(free), len(free)))
    order = np.empty(len(free), np.intp)
    order[_factored(graph, 'MMD_AT_PLUS_A').perm_c] = free
    return order


def _factored(matrix: csc_array, order: str) -> SuperLU:
    """Factor a symmetric matrix without pivoting, in an order by its name in scipy."""
    # scipy 1.11, which Ubuntu 24.04 has, takes indices of this type only.
    rows, columns = (i.astype(np.intc, copy=False) for i in (matrix.indices, matrix.indptr))
    return splu(
        csc_array((matrix.data, rows, columns), shape=matrix.shape), permc_spec=order,
        diag_pivot_thresh=0.0, options={'SymmetricMode': True})


def _linked(links: Links, rank: Indices) -> tuple[Indices, Indices]:
    """Return the ranks of both ends of the links between nodes with a rank >= 0."""
    a, b = (rank[np.concatenate(ends)] for ends in zip(*links))
    both = (a >= 0) & (b >= 0)
    return a[both], b[both]


def diagonal(values: Array) -> dia_array:
    """Return a sparse diagonal matrix; diags_array is not in scipy 1.11 of Ubuntu 24.04."""
    return dia_array((values[None], [0]), shape=(len(values), len(values)))
