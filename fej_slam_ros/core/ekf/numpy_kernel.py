# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The arithmetic of a filter step in numpy: the reference of the compiled kernel.

Costs are in flops for n states and m observations that touch k of them.
"""

import math

import numpy as np
from scipy.linalg.blas import dgemm, dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from fej_slam_ros.core import chi_square, models
from fej_slam_ros.core.geometry import Array, Indices, wrap_all
from fej_slam_ros.core.pieces import PIECE_ELEMENTS, ranges

NAME = 'numpy'
#: What computes the products of large matrices.
PRODUCTS = 'BLAS'
#: Share of its rows by which the storage of P grows: scipy's BLAS updates whole arrays in place,
#: so that spare rows cost flops.
STORAGE_GROWTH = 0.03

#: Places in the lower triangle, counted row by row, of the elements of a diagonal block, by the
#: size of the block: that of a position or of a pose.
BLOCK_ELEMENTS = {
    2: np.array([[0, 2], [2, 3]]), 3: np.array([[0, 3, 6], [3, 4, 7], [6, 7, 8]])}

squared_distances = chi_square.squared_distances


def moved(x: Array, u: Array, Q: Array) -> tuple[Array, Array]:
    """Return the pose f(x, u) (3,) and its noise G Q G^T (3, 3), eqs. (2), (4) and (6)."""
    G = models.G(x[2])
    return models.f(x, u), G.dot(Q).dot(G.T)


def Phi(x: Array, x_next: Array) -> Array:
    """Return the transition (3, 3) of a pose error from a pose (3,) to the next, eq. (5)."""
    return models.Phi(x_next[:2] - x[:2])


def propagated(before: Array | None, block: Array, Phi: Array, N: Array) -> tuple[Array, Array]:
    """Return Phi times the transition before it, and Phi P Phi^T + N, all of them (d, d)."""
    block = Phi.dot(block).dot(Phi.T) + N
    return Phi if before is None else Phi.dot(before), 0.5 * (block + block.T)


def diagonal_block(lower: Array, start: int, size: int) -> Array:
    """Return the symmetric block (size, size) of a position or a pose from its lower triangle."""
    states = slice(start, start + size)
    return lower[states, states].take(BLOCK_ELEMENTS[size])


def settle(lower: Array, n: int, start: int, Phi: Array, block: Array) -> None:
    """Apply a transition Phi (d, d) to the cross-covariances of the d states from start on."""
    stop = start + len(Phi)
    row, column = lower[start:stop, :start], lower[stop:n, start:stop]
    row[:] = Phi.dot(row)
    column[:] = column @ Phi.T
    lower[start:stop, start:stop] = block


def columns(lower: Array, indices: Indices) -> Array:
    """Return full columns, (capacity, k) in Fortran order, of a matrix from its lower triangle."""
    count, capacity = len(indices), len(lower)
    if count * capacity <= PIECE_ELEMENTS:
        return _columns(lower, indices)
    full = np.empty((capacity, count), order='F')
    for part in ranges(count, PIECE_ELEMENTS / capacity):
        full[:, part] = _columns(lower, indices[part])
    return full


def _columns(lower: Array, indices: Indices) -> Array:
    full = lower.T.take(indices, 0).T
    for k, j in enumerate(indices.tolist()):
        full[:j, k] = lower[j, :j]
    return full


def replace_columns(lower: Array, indices: Indices, full: Array) -> None:
    """Replace columns and rows of a symmetric matrix by `full`, a (capacity, k) Fortran array."""
    for k, j in enumerate(indices.tolist()):
        lower[j:, j] = full[j:, k]
        lower[j, :j] = full[:j, k]


def compact(columns: Indices, blocks: Array, n: int) -> tuple[Indices, Array]:
    """
    Return the k of n states that observations depend on, in order, and H (2 m, k) in these.

    Parameters
    ----------
    columns : (m, d) array, the states that each of the m observations depends on
    blocks : (m, 2, d) array, the Jacobian with respect to those states
    n : number of states

    """
    m, touched = len(columns), np.zeros(n, np.bool_)
    touched[columns] = True
    states, = touched.nonzero()
    k = len(states)
    # A state may be listed twice in a row; its entries are added.
    cells = states.searchsorted(columns)[:, None] + np.arange(2 * m).reshape(m, 2, 1) * k
    entries = np.bincount(cells.ravel(), blocks.ravel(), 2 * m * k)
    return states, entries.reshape(2 * m, k).astype(np.float64, copy=False)


def stacked(
    observers: list[int], observed: list[int], z: list[Array], R: list[Array]
) -> tuple[Indices, Array, Array]:
    """
    Return the states (m, 5) that m observations depend on, z (m, 2) and R (m, 2, 2).

    Parameters
    ----------
    observers, observed : the first state of the pose and of the position of each observation
    z, R : (2,) and (2, 2) arrays, measurements and their noise

    """
    states = np.array([(i, i + 1, i + 2, j, j + 1) for i, j in zip(observers, observed)], np.intp)
    return states, np.array(z, np.float64), np.array(R, np.float64)


def h(x: Array) -> Array:
    """Return the observations (m, 2) of points by robots, both in x (m, 5), eq. (7)."""
    return models.h(x[:, :3], x[:, 3:])


def H(x: Array) -> Array:
    """Return their Jacobians (m, 2, 5), eqs. (10) and (11)."""
    return models.H(x[:, :3], x[:, 3:])


def project(
    lower: Array, n: int, observed: Indices, blocks: Array, R: Array
) -> tuple[Array, Array, Array, Array]:
    """
    Return the columns of P (rows, k), H (2 m, k), S = H P H^T + R and its (2, 2) blocks.

    There are n rows, or capacity rows that are zero from n on. Takes 4 m k^2 + 8 m^2 k flops.

    Parameters
    ----------
    lower : (capacity, capacity) Fortran array, the lower triangle of P, zero beyond row n
    n : number of states
    observed, blocks : the Jacobian as in `compact`
    R : (m, 2, 2) array, the noise of each observation

    """
    states, sparse = compact(observed, blocks, n)
    P = columns(lower, states)
    S = sparse.dot(P[states]).dot(sparse.T)
    m = len(R)
    own = np.einsum('iaib->iab', S.reshape(m, 2, m, 2))
    own += R
    return P, sparse, S, own


def correction(
    P: Array, H: Array, S: Array, r: Array, n: int
) -> tuple[Array, Array, Array, float]:
    """
    Return dx = K r (n,), y = L^-1 r, W = P H^T L^-T and log det S, with K = W L^-1, S = L L^T.

    Raises
    ------
    ArithmeticError
        If S is not positive definite: the filter's own covariance is broken.

    """
    L, failed_at = dpotrf(S, lower=1)  # S = L L^T: 8/3 m^3
    if failed_at:
        raise ArithmeticError(f'innovation covariance not positive definite at {failed_at}')
    white_H = dtrsm(1.0, L, H, lower=1)  # L^-1 H: 4 m^2 k
    W = dgemm(1.0, P, white_H, trans_b=1)  # W = P H^T L^-T: 4 m k n
    y: Array = dtrsv(L, r, lower=1)  # y = L^-1 r: 4 m^2
    log_det = 2.0 * sum(map(math.log, L.diagonal().tolist()))
    return W[:n] @ y, y, W, log_det


def product(A: Array, B: Array) -> Array:
    """Return A B (m, n) of A (m, k) and B (k, n): 2 m k n flops."""
    return A @ B


def subtract_product(lower: Array, W: Array, n: int) -> None:  # noqa: ARG001
    """Subtract W W^T of W (capacity, k), zero beyond row n, in place: k n^2 flops."""
    dsyrk(-1.0, W, beta=1.0, c=lower, lower=1, overwrite_c=1)


def retracted(x: Array, dx: Array, headings: Indices) -> Array:
    """Return x + dx (n,) with wrapped headings."""
    corrected: Array = x + dx
    corrected[headings] = wrap_all(corrected[headings])
    return corrected
