# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The product of two matrices, in pieces if they are large."""

import numpy as np

from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.pieces import EndedError, must_end, PIECE_FLOPS, ranges


def product(A: Array, B: Array, may_end: bool = False) -> Array:
    """
    Return A B, by rows of A if it is large.

    If it may end early, it raises EndedError then.

    """
    rows, inner = A.shape
    size = PIECE_FLOPS / max(2 * inner * B.shape[1], 1)
    if rows <= size:
        return KERNEL.product(A, B)
    result = np.empty((rows, B.shape[1]))
    for part in ranges(rows, size):
        if may_end and must_end():
            raise EndedError
        result[part] = KERNEL.product(A[part], B)
    return result
