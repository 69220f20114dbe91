# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Blocks of the inverse of a sparse matrix, where its Cholesky factor is not zero.

Takahashi's recursion over blocks: with the unit lower triangular factor L of a block j, the
diagonal D of pivots, and the rows S of L below the block,

    Z_Sj = -Z_SS L_Sj L_jj^-1,    Z_jj = (L_jj D L_jj^T)^-1 - (L_Sj L_jj^-1)^T Z_Sj.

The rows S are among those of the next block that j is linked to, its parent, and that block. So
one block after another, from the last to the first, needs the inverse over the rows of its parent
only.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_array

from fej_slam_ros.core.geometry import Array, Indices, runs


class InverseBlock(NamedTuple):
    """Columns of a block in the inverse."""

    block: int  #: index of the block
    linked: Indices  #: (k,) array, indices of the later blocks it is linked to
    Z: Array  #: (w, w) array, on the diagonal
    #: (r, w) array, in the rows of the linked blocks, one below the other
    Z_linked: Array


def inverse_blocks(
    L: csc_array, pivots: Array, pattern: csc_array, sizes: Indices
) -> Iterator[InverseBlock]:
    """
    Yield the blocks from the last to the first.

    Parameters
    ----------
    L : (u, u) sparse array, unit lower triangular factor L D L^T of the matrix
    pivots : (u,) array, diagonal of D
    pattern : (u, u) sparse array, the matrix
    sizes : (m,) array, number of rows of each block; blocks are dense

    """
    starts = np.cumsum(sizes) - sizes
    links = _filled(pattern, sizes)
    parents = [int(linked[0]) if len(linked) else -1 for linked in links]
    children = np.bincount(np.array(parents) + 1, minlength=len(sizes) + 1)[1:]
    # Rows of a block and of those it is linked to, and the inverse in these; until all blocks of
    # which it is the parent are done.
    fronts: dict[int, tuple[Indices, Array]] = {}
    for j in range(len(sizes) - 1, -1, -1):
        w, linked = int(sizes[j]), links[j]
        rows = np.concatenate([
            np.arange(starts[j], starts[j] + w), runs(starts[linked], sizes[linked])])
        dense = _columns(L, int(starts[j]), w, rows)
        L_inv = np.linalg.inv(dense[:w])
        Z = L_inv.T @ (L_inv / pivots[rows[:w], None])
        Z_linked, Z_SS = np.zeros((0, w)), np.zeros((0, 0))
        if len(linked):
            rows_p, Z_p = fronts[parents[j]]
            at = np.searchsorted(rows_p, rows[w:])
            Z_SS = Z_p[at[:, None], at]
            B = dense[w:] @ L_inv
            Z_linked = -Z_SS @ B
            Z = Z - B.T @ Z_linked
            children[parents[j]] -= 1
            if not children[parents[j]]:
                del fronts[parents[j]]
        if children[j]:
            front = np.empty((len(rows), len(rows)))
            front[:w, :w], front[w:, :w], front[:w, w:], front[w:, w:] = (
                Z, Z_linked, Z_linked.T, Z_SS)
            fronts[j] = rows, front
        yield InverseBlock(j, linked, Z, Z_linked)


def _columns(L: csc_array, start: int, width: int, rows: Indices) -> Array:
    """Return the columns of a block in some rows; L has no explicit zeros."""
    begin, end = L.indptr[start], L.indptr[start + width]
    column = np.repeat(np.arange(width), np.diff(L.indptr[start:start + width + 1]))
    dense = np.zeros((len(rows), width))
    dense[np.searchsorted(rows, L.indices[begin:end]), column] = L.data[begin:end]
    return dense


def _filled(pattern: csc_array, sizes: Indices) -> Sequence[Indices]:
    """Return the later blocks that each block is linked to after the elimination, sorted."""
    block_of = np.repeat(np.arange(len(sizes)), sizes)
    pairs = pattern.tocoo()
    row, column = block_of[pairs.row], block_of[pairs.col]
    later = row > column
    keys = np.unique(column[later] * len(sizes) + row[later])
    column, row = np.divmod(keys, len(sizes))
    own = np.split(row, np.searchsorted(column, np.arange(1, len(sizes))))
    links = [set(linked.tolist()) for linked in own]
    for linked in links:
        if linked:
            parent = min(linked)
            links[parent] |= linked
            links[parent].discard(parent)
    return [np.array(sorted(linked), np.intp) for linked in links]
