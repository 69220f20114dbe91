# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The chi-square distribution and squared Mahalanobis distances."""

from functools import cache

from scipy.special import chdtri, gammaincinv

from fej_slam_ros.core.geometry import Array


@cache
def band_per_dof(dof: float, probability: float = 0.95) -> tuple[float, float]:
    """Return the central interval of a consistent filter's NEES/dof or NIS/dof; dof in all."""
    tail = (1.0 - probability) / 2.0
    return float(chdtri(dof, 1.0 - tail)) / dof, float(chdtri(dof, tail)) / dof


def chi_square_quantile(dof: int, probability: float) -> float:
    """Return the quantile of this probability, with dof degrees of freedom."""
    return 2.0 * float(gammaincinv(dof / 2, probability))


def own_blocks(S: Array) -> Array:
    """Return the diagonal blocks (m, 2, 2) of a matrix (2 m, 2 m)."""
    m = len(S) // 2
    return S.reshape(m, 2, m, 2).diagonal(axis1=0, axis2=2).transpose(2, 0, 1)


def squared_distances(r: Array, blocks: Array) -> Array:
    """Return r^T S^-1 r (m,) of residuals r (m, 2) with covariances S (m, 2, 2)."""
    x, y = r.T
    xx, xy, yy = blocks[:, 0, 0], blocks[:, 1, 0], blocks[:, 1, 1]
    d2: Array = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy)
    return d2
