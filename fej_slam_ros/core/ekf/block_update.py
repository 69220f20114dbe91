# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
r"""
The joint update of many observations, in blocks.

The Cholesky factor of S = H P H^T + R is computed one block row at a time: the rows of later
blocks see P - W W^T and r - H dx of the earlier ones, which is their Schur complement. Estimate,
covariance, whitened innovation and log det S are therefore those of the joint update but for
rounding, and neither S, of (2 m)^2 elements, nor its m^3 flops are needed: 2 m n^2 flops, linear
in the number of observations. After each block, the estimate is that of the blocks so far, so the
update may end early.
"""

from dataclasses import dataclass
import math

import numpy as np

from fej_slam_ros.core.ekf.compressed_covariance import JointCovariance
from fej_slam_ros.core.ekf.covariance import SparseRows
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.pieces import pause, PIECE_FLOPS

#: Maximum number of observations of an update that is not divided.
MAX_JOINT_OBSERVATIONS = 256
#: Maximum number of observations of a block: more take more flops for S, fewer make BLAS slow.
MAX_BLOCK_OBSERVATIONS = 64
#: Minimum number.
MIN_BLOCK_OBSERVATIONS = 16


@dataclass(frozen=True, slots=True, eq=False)
class BlockUpdate:
    """Result of an update in blocks."""

    count: int  #: number of observations used, all unless the update ended early
    dx: Array  #: (n,) array, the correction K r
    y: Array  #: (2 count,) array, the whitened innovation L^-1 r
    log_det: float  #: log det S


def is_divided(covariance: JointCovariance, count: int) -> bool:
    """Return whether an update of `count` observations is done in blocks."""
    return count > max(
        MIN_BLOCK_OBSERVATIONS, min(MAX_JOINT_OBSERVATIONS, _affordable(covariance)))


def block_size(covariance: JointCovariance) -> int:
    """Return the number of observations of a block, one piece of work."""
    return max(
        MIN_BLOCK_OBSERVATIONS, min(MAX_BLOCK_OBSERVATIONS, _affordable(covariance)))


def own_covariances(covariance: JointCovariance, H: SparseRows, R: Array) -> Array:
    """Return the diagonal blocks (m, 2, 2) of S = H P H^T + R."""
    P = covariance.blocks(H.columns)
    S: Array = H.blocks @ P @ H.blocks.transpose(0, 2, 1) + R
    return S


def update_in_blocks(
    covariance: JointCovariance, H: SparseRows, R: Array, r: Array
) -> BlockUpdate:
    """Update a covariance for residuals r (2 m,) of noise R (m, 2, 2); return the correction."""
    count, size = len(R), block_size(covariance)
    dx, y, log_det, done = np.zeros(covariance.dimension), [], 0.0, 0
    for _ in range(math.ceil(count / size)):
        if done and pause():
            break
        block = slice(done, min(done + size, count))
        rows = SparseRows(H.columns[block], H.blocks[block])
        prior = covariance.project(rows, R[block])
        correction = covariance.correction(
            prior, r[2 * block.start:2 * block.stop] - rows.of(dx))
        covariance.condition(correction)
        dx += correction.dx
        y.append(correction.y)
        log_det += correction.log_det
        done = block.stop
    return BlockUpdate(done, dx, np.concatenate([np.empty(0), *y]), log_det)


def _affordable(covariance: JointCovariance) -> int:
    """Return the number of observations whose update is one piece of work."""
    return int(PIECE_FLOPS / max(2 * covariance.matrices[-1].dimension ** 2, 1))
