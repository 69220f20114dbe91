# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The arithmetic of a filter step, compiled: `numpy_kernel` within rounding, for less time per call.

A step of a small map takes most of its time in numpy's calls, not in its flops. The functions of
``_kernel.c`` take and return the same as those of the other kernel.
"""

from fej_slam_ros.core.ekf import _kernel, numpy_kernel
from fej_slam_ros.core.ekf._kernel import (
    correction, diagonal_block, H, h, moved, Phi, propagated, replace_columns,
    retracted, settle, squared_distances, stacked, subtract_product)
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.pieces import PIECE_ELEMENTS

__all__ = [
    'NAME', 'PRODUCTS', 'STORAGE_GROWTH', 'H', 'Phi', 'columns', 'correction', 'diagonal_block',
    'h', 'moved', 'product', 'project', 'propagated', 'replace_columns', 'retracted', 'settle',
    'squared_distances', 'stacked', 'subtract_product']

NAME = 'compiled'
PRODUCTS = _kernel.PRODUCTS
#: Share of its rows by which the storage of P grows: an update costs the rows in use only, so that
#: storage is copied rarely.
STORAGE_GROWTH = 0.25


def columns(lower: Array, indices: Indices) -> Array:
    """Return full columns of P; in pieces, by the other kernel, where they are large."""
    if len(indices) * len(lower) > PIECE_ELEMENTS:
        return numpy_kernel.columns(lower, indices)
    return _kernel.columns(lower, indices)


def product(A: Array, B: Array) -> Array:
    """Return A B; in the order of a Fortran array A if this has more rows than B columns."""
    if len(A) > B.shape[1]:
        return _kernel.product(B.T, A.T).T
    return _kernel.product(A, B)


def project(
    lower: Array, n: int, observed: Indices, blocks: Array, R: Array
) -> tuple[Array, Array, Array, Array]:
    """Return P, H, S and its blocks; in pieces, by the other kernel, where P is large."""
    if n * min(observed.size, n) > PIECE_ELEMENTS:
        return numpy_kernel.project(lower, n, observed, blocks, R)
    return _kernel.project(lower, n, observed, blocks, R)
