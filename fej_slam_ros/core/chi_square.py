# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The chi-square distribution and squared Mahalanobis distances."""

from functools import cache

import numpy as np
from scipy.special import chdtri, gammaincinv

from fej_slam_ros.core.geometry import Array

#: Smallest variance of a residual, relative to that of its own measurement, at which the others
#: test it. Below it, they predict the measurement a thousand times worse than it is, and the
#: residual is rounding.
MIN_REDUNDANCY = 1e-6


@cache
def band_per_dof(dof: float, probability: float = 0.95) -> tuple[float, float]:
    """Return the central interval of a consistent filter's NEES/dof or NIS/dof; dof in all."""
    tail = (1.0 - probability) / 2.0
    return chi_square_limit(dof, 1.0 - tail) / dof, chi_square_limit(dof, tail) / dof


def chi_square_quantile(dof: int, probability: float) -> float:
    """Return the quantile of this probability, with dof degrees of freedom."""
    return 2.0 * float(gammaincinv(dof / 2, probability))


def chi_square_limit(dof: float, tail: float) -> float:
    """Return the quantile of probability 1 - tail, without rounding a small tail."""
    return float(chdtri(dof, tail))


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


def distances_where_tested(r: Array, S: Array) -> Array:
    """
    Return r^T S^-1 r (m,) of whitened residuals in the directions that other measurements test.

    Parameters
    ----------
    r : (m, d) array, residuals, whitened by the noise of their own measurements
    S : (m, d, d) array, their covariances

    """
    variances, directions = np.linalg.eigh(S)
    along = np.einsum('mij,mi->mj', directions, r)
    is_tested = variances > MIN_REDUNDANCY
    d2: Array = np.sum(
        np.square(along) * is_tested / np.where(is_tested, variances, 1.0), axis=1)
    return d2


def increases_of_chi_square(r: Array, D: Array, S: Array, fitted: int) -> Array:
    """
    Return by how much the chi-square of a least squares fit increases with each point left out.

    It is the squared Mahalanobis distance of a point's residual from the one that the fitted ones
    predict.

    Parameters
    ----------
    r, D, S : (2 m,), (2 m, u) and (2 m, 2 m) arrays, residuals at the fit of u unknowns, their
        Jacobian and covariance, those of the fitted points first
    fitted : number of residuals of the fitted points

    """
    of_fit, rest = slice(fitted), slice(fitted, None)
    whitened = np.linalg.solve(
        S[of_fit, of_fit], np.column_stack([S[of_fit, rest], r[of_fit], D[of_fit]]))
    left = len(r) - fitted
    K, of_r, of_D = whitened[:, :left].T, whitened[:, left], whitened[:, left + 1:]
    P = np.linalg.inv(D[of_fit].T @ of_D)
    D_e = D[rest] - S[rest, of_fit] @ of_D
    S_e = S[rest, rest] - K @ S[of_fit, rest] + D_e @ P @ D_e.T
    return squared_distances(
        (r[rest] - S[rest, of_fit] @ of_r).reshape(-1, 2), own_blocks(S_e))
