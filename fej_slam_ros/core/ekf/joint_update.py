# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
r"""
The joint update of observations: of all at once or, if they are many, in blocks.

In blocks, the Cholesky factor of S = H P H^T + R is computed one block row at a time: the rows of
later blocks see P - W W^T and r - H dx of the earlier ones, which is their Schur complement.
Estimate, covariance, whitened innovation and log det S are therefore those of the update at once
but for rounding, and neither S, of (2 m)^2 elements, nor its m^3 flops are needed: 2 m n^2 flops,
linear in the number of observations. After each block, the estimate is that of the blocks so far,
so the update may end early.
"""

from copy import copy
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.ekf.covariance import Correction, SparseRows
from fej_slam_ros.core.ekf.joint_covariance import JointCovariance
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.pieces import pause, PIECE_FLOPS

#: Maximum number of observations of an update that is not divided.
MAX_JOINT_OBSERVATIONS = 256
#: Maximum number of observations of a block: more take more flops for S, fewer make BLAS slow.
MAX_BLOCK_OBSERVATIONS = 64
#: Minimum number.
MIN_BLOCK_OBSERVATIONS = 16


class CorrectionInBlocks(NamedTuple):
    """The correction by the blocks of an update, all unless it ended early."""

    dx: Array  #: (n,) array, the correction K r
    y: Array  #: (2 m,) array, the whitened innovation L^-1 r of the m observations used
    log_det: float  #: log det S


class UpdateAtOnce:
    """The update by all observations together."""

    def __init__(self, covariance: JointCovariance, H: SparseRows, R: Array, r: Array) -> None:
        self._covariance, self._r = covariance, r
        self._prior = covariance.project(H, R)
        self._correction: Correction | None = None
        #: (2 m, 2 m) array, the lower triangle of S
        self.S: Array | None = self._prior.S

    def own(self) -> Array:
        """Return the diagonal blocks (m, 2, 2) of S."""
        return self._prior.own

    def correction(self) -> Correction:
        """Return the correction; the covariance stays as it is."""
        if self._correction is None:
            self._correction = self._covariance.correction(self._prior, self._r)
        return self._correction

    def apply(self) -> Correction:
        """Return the correction, and update the covariance."""
        correction = self.correction()
        self._covariance.condition(correction)
        return correction


class UpdateInBlocks:
    """The same block by block; the process may end after any of them."""

    def __init__(self, covariance: JointCovariance, H: SparseRows, R: Array, r: Array) -> None:
        self._covariance, self._H, self._R, self._r = covariance, H, R, r
        self.S: Array | None = None  #: S is not computed as a whole

    def own(self) -> Array:
        """Return the diagonal blocks (m, 2, 2) of S."""
        P, H = self._covariance.blocks(self._H.columns), self._H.blocks
        return H @ P @ H.transpose(0, 2, 1) + self._R

    def correction(self) -> CorrectionInBlocks:
        """Return the correction; the covariance stays as it is."""
        return self._applied(copy(self._covariance))

    def apply(self) -> CorrectionInBlocks:
        """Return the correction, and update the covariance."""
        return self._applied(self._covariance)

    def _applied(self, covariance: JointCovariance) -> CorrectionInBlocks:
        count, size = len(self._R), block_size(covariance)
        dx, y, log_det, done = np.zeros(covariance.dimension), [], 0.0, 0
        for _ in range(math.ceil(count / size)):
            if done and pause():
                break
            block = slice(done, min(done + size, count))
            rows = SparseRows(self._H.columns[block], self._H.blocks[block])
            prior = covariance.project(rows, self._R[block])
            correction = covariance.correction(
                prior, self._r[2 * block.start:2 * block.stop] - rows.of(dx))
            covariance.condition(correction)
            dx += correction.dx
            y.append(correction.y)
            log_det += correction.log_det
            done = block.stop
        return CorrectionInBlocks(dx, np.concatenate([np.empty(0), *y]), log_det)


#: Both have the same methods.
JointUpdate = UpdateAtOnce | UpdateInBlocks


def joint_update(
    covariance: JointCovariance, H: SparseRows, R: Array, r: Array
) -> JointUpdate:
    """Return the update by m observations of noise R (m, 2, 2) and residuals r (2 m,)."""
    if len(R) <= max(
            MIN_BLOCK_OBSERVATIONS, min(MAX_JOINT_OBSERVATIONS, _affordable(covariance))):
        return UpdateAtOnce(covariance, H, R, r)
    return UpdateInBlocks(covariance, H, R, r)


def block_size(covariance: JointCovariance) -> int:
    """Return the number of observations of a block, one piece of work."""
    return max(
        MIN_BLOCK_OBSERVATIONS, min(MAX_BLOCK_OBSERVATIONS, _affordable(covariance)))


def _affordable(covariance: JointCovariance) -> int:
    """Return the number of observations whose update is one piece of work."""
    return int(PIECE_FLOPS / max(2 * covariance.matrices[-1].dimension ** 2, 1))
