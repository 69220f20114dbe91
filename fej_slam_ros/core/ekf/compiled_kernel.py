# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The arithmetic of a filter step, compiled: `numpy_kernel` within rounding, for less time per call.

A step of a small map takes most of its time in numpy's calls, not in its flops. This module
allocates the results of ``_kernel.c``, in which a function has the arguments of the one here,
the results as arrays, and numbers last.
"""

import numpy as np

from fej_slam_ros.core.ekf import _kernel, numpy_kernel
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.pieces import PIECE_ELEMENTS

NAME = 'compiled'

#: Of many states at once, where a call more does not count.
columns, compact = numpy_kernel.columns, numpy_kernel.compact

_IDENTITIES = {d: np.eye(d) for d in (2, 3)}


def moved(x: Array, u: Array, Q: Array) -> tuple[Array, Array]:
    """Return the pose f(x, u) (3,) and its noise G Q G^T (3, 3), eqs. (2), (4) and (6)."""
    x_pred, N = np.empty(3), np.empty((3, 3))
    _kernel.moved(x, u, Q, x_pred, N)
    return x_pred, N


def propagated(before: Array | None, block: Array, Phi: Array, N: Array) -> tuple[Array, Array]:
    """Return Phi times the transition before it, and the diagonal block Phi P Phi^T + N."""
    transition, result = np.empty_like(Phi), np.empty_like(Phi)
    before = _IDENTITIES[len(Phi)] if before is None else before
    _kernel.propagated(before, block, Phi, N, transition, result)
    return transition, result


def settle(lower: Array, n: int, start: int, Phi: Array, block: Array) -> None:
    """Apply a transition Phi (d, d) to the cross-covariances of the d states from start on."""
    _kernel.settle(lower, Phi, block, n, start)


def h(poses: Array, points: Array) -> Array:
    """Return points (m, 2) in the base frames of m robots at poses (m, 3), eq. (7)."""
    z = np.empty((len(poses), 2))
    _kernel.h(poses, points, z)
    return z


def H(poses: Array, points: Array) -> Array:
    """Return the Jacobians (m, 2, 5) of eq. (7), eqs. (10) and (11)."""
    blocks = np.empty((len(poses), 2, 5))
    _kernel.H(poses, points, blocks)
    return blocks


def observed_states(starts: Indices) -> Indices:
    """Return the states (m, 5) of m observers and observed points, by their starts (2 m,)."""
    columns = np.empty((len(starts) // 2, 5), np.intp)
    _kernel.observed_states(starts, columns)
    return columns


def project(
    lower: Array, n: int, observed: Indices, blocks: Array, R: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the columns of P (capacity, k), H (2 m, k), S = H P H^T + R and its (2, 2) blocks."""
    capacity, most = len(lower), min(observed.size, n)
    if capacity * most > PIECE_ELEMENTS:
        return numpy_kernel.project(lower, n, observed, blocks, R)
    rows = 2 * len(R)
    P, S = np.empty((capacity, most), order='F'), np.empty((rows, rows))
    sparse, own = np.empty((rows, most), order='F'), np.empty(R.shape)
    k = _kernel.project(lower, observed, blocks, R, P, sparse, S, own, n)
    return P[:, :k], sparse[:, :k], S, own


def squared_distances(r: Array, S: Array) -> Array:
    """Return r^T S^-1 r (m,) of residuals r (m, 2) with covariances S (m, 2, 2)."""
    d2 = np.empty(len(r))
    _kernel.squared_distances(r, S, d2)
    return d2


def correction(
    P: Array, H: Array, S: Array, r: Array, n: int
) -> tuple[Array, Array, Array, float]:
    """Return dx = K r (n,), y = L^-1 r, W = P H^T L^-T and log det S; errors as in the other."""
    y, dx, W = r.copy(), np.empty(n), np.empty((len(P), len(r)), order='F')
    log_det = _kernel.correction(P, H.copy('F'), S.copy(), y, dx, W)
    return dx, y, W, log_det


def subtract_product(lower: Array, W: Array, n: int) -> Array:
    """Subtract W W^T from a triangle in place and return it."""
    _kernel.subtract_product(lower, W, n)
    return lower


def retracted(x: Array, dx: Array, headings: Indices) -> Array:
    """Return x + dx (n,) with wrapped headings."""
    result = np.empty(len(x))
    _kernel.retracted(x, dx, headings, result)
    return result
