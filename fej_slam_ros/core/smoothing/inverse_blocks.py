# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Blocks of the inverse of a sparse matrix, where its Cholesky factor is not zero.

Takahashi's recursion over blocks: with the unit lower triangular factor L of a block j, the
diagonal D of pivots, and the rows S of L below the block,

    Z_Sj = -Z_SS L_Sj L_jj^-1,    Z_jj = (L_jj D L_jj^T)^-1 - (L_Sj L_jj^-1)^T Z_Sj.

The rows S are among those of the next block that j is linked to, its parent, and that block: the
front of the parent. So each level of the tree of parents needs the inverse over the fronts of the
level above only, and the blocks of one level that have equal shapes are computed together.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from fej_slam_ros.core.geometry import Array, distinct, Indices, runs, starts_of

#: Maximum number of elements of the fronts that are computed together: 16 MB for each of a few.
MAX_ELEMENTS = 2_000_000


class InverseBlocks(NamedTuple):
    """Columns in the inverse of blocks of equal shapes."""

    blocks: Indices  #: (g,) array, indices of the blocks
    Z: Array  #: (g, w, w) array, on the diagonal
    rows: Indices  #: (g, r) array, rows of the later blocks that each block is linked to
    Z_linked: Array  #: (g, r, w) array, in these rows


def inverse_blocks(
    L: csc_array, pivots: Array, pattern: csc_array, sizes: Indices
) -> Iterator[InverseBlocks]:
    """
    Yield all blocks, each after those that it is linked to.

    Parameters
    ----------
    L : (u, u) sparse array, unit lower triangular factor L D L^T of the matrix
    pivots : (u,) array, diagonal of D
    pattern : (u, u) sparse array, the matrix
    sizes : (m,) array, number of rows of each block; blocks are dense

    """
    fronts, inverses = _Fronts(pattern, sizes), _InversesOfLevel(len(sizes))
    columns = fronts.columns(L)
    for level in fronts.levels():
        for group in level:
            w, rows, parents = int(sizes[group[0]]), fronts.rows(group), fronts.parents[group]
            Z_SS = inverses.among(parents, fronts.heights[parents], fronts.in_parent(group))
            Z, Z_linked = _inverse_columns(
                columns.of(group, rows.shape[1], w), pivots[rows[:, :w]], Z_SS)
            yield InverseBlocks(group, Z, rows[:, w:], Z_linked)
            inner = fronts.is_parent[group]
            inverses.add(group[inner], np.block([
                [Z[inner], Z_linked[inner].transpose(0, 2, 1)], [Z_linked[inner], Z_SS[inner]]]))
        inverses.descend()


def _inverse_columns(L_j: Array, D_j: Array, Z_SS: Array) -> tuple[Array, Array]:
    """
    Return Z_jj (g, w, w) and Z_Sj (g, r, w) of g blocks by Takahashi's recursion.

    Parameters
    ----------
    L_j : (g, w + r, w) array, L_jj over L_Sj
    D_j : (g, w) array, pivots
    Z_SS : (g, r, r) array, the inverse in the rows and columns S

    """
    w = D_j.shape[1]
    L_inv = np.linalg.inv(L_j[:, :w])
    B = L_j[:, w:] @ L_inv
    Z_Sj = -Z_SS @ B
    Z_jj = L_inv.transpose(0, 2, 1) @ (L_inv / D_j[:, :, None]) - B.transpose(0, 2, 1) @ Z_Sj
    return Z_jj, Z_Sj


class _InversesOfLevel:
    """The inverse over each front of one level, while those of the level below are added."""

    def __init__(self, blocks: int) -> None:
        #: (m,) array, position of the first element of each block in the array of its level
        self._begins = np.zeros(blocks, np.intp)
        self._elements = np.empty(0)
        self._below, self._size = [np.empty(0)], 0

    def among(self, blocks: Indices, heights: Indices, places: Indices) -> Array:
        """Return the inverse (g, r, r) at places (g, r) in the fronts of g blocks."""
        down, right = places[:, :, None] * heights[:, None, None], places[:, None, :]
        found: Array = self._elements[self._begins[blocks, None, None] + down + right]
        return found

    def add(self, blocks: Indices, inverses: Array) -> None:
        """Add the inverses (g, h, h) over the fronts of g blocks of the level below."""
        h = inverses.shape[1]
        self._begins[blocks] = self._size + h ** 2 * np.arange(len(blocks))
        self._below.append(inverses.ravel())
        self._size += inverses.size

    def descend(self) -> None:
        """Continue with the level below."""
        self._elements = np.concatenate(self._below)
        self._below, self._size = [np.empty(0)], 0


class _Fronts:
    """
    The rows of each block followed by those of the blocks it is linked to, block by block.

    Attributes
    ----------
    parents : (m,) array, next block that each block is linked to, -1 without one
    is_parent : (m,) array, whether another block has it as its parent
    linked, heights : (m,) arrays, number of linked rows, and of all rows of its front

    """

    def __init__(self, pattern: csc_array, sizes: Indices) -> None:
        links, m, u = _filled(pattern, sizes), len(sizes), int(sizes.sum())
        later = np.concatenate([np.empty(0, np.intp), *links])
        self.parents = np.array([linked[0] if len(linked) else -1 for linked in links], np.intp)
        self.is_parent = np.bincount(self.parents + 1, minlength=m + 1)[1:] > 0
        self.linked = np.bincount(
            np.repeat(np.arange(m), [len(linked) for linked in links]), sizes[later],
            minlength=m).astype(np.intp)
        self.heights = sizes + self.linked
        self._sizes = sizes
        self._first_rows, self._begins = starts_of(sizes), starts_of(self.heights)
        below = runs(self._begins + sizes, self.linked)
        self._rows = np.empty(int(self.heights.sum()), np.intp)
        self._rows[runs(self._begins, sizes)] = np.arange(u)
        self._rows[below] = runs(self._first_rows[later], sizes[later])
        # Ascending, so that a row is found by bisection.
        self._keys = np.repeat(np.arange(m), self.heights) * u + self._rows
        self._in_parent = np.zeros_like(self._rows)
        self._in_parent[below] = self._places(
            np.repeat(self.parents, self.linked), self._rows[below])

    def rows(self, group: Indices) -> Indices:
        """Return all rows, (g, w + r), of the fronts of g blocks of equal shapes."""
        at = self._begins[group, None] + np.arange(self.heights[group[0]])
        rows: Indices = self._rows[at]
        return rows

    def in_parent(self, group: Indices) -> Indices:
        """Return the places (g, r) of their linked rows in the fronts of their parents."""
        first = self._begins[group] + self._sizes[group]
        places: Indices = self._in_parent[first[:, None] + np.arange(self.linked[group[0]])]
        return places

    def columns(self, L: csc_array) -> '_DenseColumns':
        """Return the columns of a factor in its blocks; it may have no explicit zeros."""
        column = np.repeat(np.arange(L.shape[1]), np.diff(L.indptr))
        block = np.repeat(np.arange(len(self._sizes)), self._sizes)[column]
        counts = self.heights * self._sizes
        begins, elements = starts_of(counts), np.zeros(int(counts.sum()))
        place = self._places(block, L.indices)
        elements[
            begins[block] + self._sizes[block] * place + column - self._first_rows[block]] = L.data
        return _DenseColumns(begins, elements)

    def levels(self) -> Iterator[list[Indices]]:
        """Yield the blocks of each level of the tree, in groups of equal shapes."""
        level = np.zeros(len(self.parents), np.intp)
        for j in range(len(level) - 1, -1, -1):
            if self.parents[j] >= 0:
                level[j] = level[self.parents[j]] + 1
        order = np.lexsort((self.linked, self._sizes, level))
        shapes = np.stack([level, self._sizes, self.linked])[:, order]
        groups = np.split(order, np.flatnonzero(np.diff(shapes).any(axis=0)) + 1)
        for _, of_level in groupby(filter(len, groups), key=lambda group: level[group[0]]):
            yield [part for group in of_level for part in self._parts(group)]

    def _parts(self, group: Indices) -> list[Indices]:
        elements = len(group) * int(self.heights[group[0]]) ** 2
        return np.array_split(group, min(len(group), 1 + elements // MAX_ELEMENTS))

    def _places(self, blocks: Indices, rows: Indices) -> Indices:
        """Return the places of rows in the fronts of blocks."""
        found = np.searchsorted(self._keys, blocks * int(self._sizes.sum()) + rows)
        places: Indices = found - self._begins[blocks]
        return places


class _DenseColumns(NamedTuple):
    """Dense columns of each block in the rows of its front."""

    begins: Indices  #: (m,) array, position of the elements of each block
    elements: Array

    def of(self, group: Indices, height: int, width: int) -> Array:
        """Return the columns (g, height, width) of g blocks."""
        at = self.begins[group, None] + np.arange(height * width)
        columns: Array = self.elements[at].reshape(-1, height, width)
        return columns


def _filled(pattern: csc_array, sizes: Indices) -> Sequence[Indices]:
    """Return the later blocks that each block is linked to after the elimination, sorted."""
    block_of = np.repeat(np.arange(len(sizes)), sizes)
    pairs = pattern.tocoo()
    row, column = block_of[pairs.row], block_of[pairs.col]
    later = row > column
    keys = distinct(column[later] * len(sizes) + row[later])
    column, row = np.divmod(keys, len(sizes))
    own = np.split(row, np.searchsorted(column, np.arange(1, len(sizes))))
    links = [set(linked.tolist()) for linked in own]
    for linked in links:
        if linked:
            parent = min(linked)
            links[parent] |= linked
            links[parent].discard(parent)
    return [np.array(sorted(linked), np.intp) for linked in links]
