# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definiteness of covariances: positive definite beyond rounding, or semi-definite up to it."""

import math

import numpy as np
from scipy.linalg.lapack import dpotrf

from fej_slam_ros.core.geometry import Array, Flags

#: Smallest eigenvalue of a correlation matrix that counts as regular, well above rounding.
MIN_CORRELATION_EIGENVALUE = 1e-12
#: Magnitude of a negative eigenvalue, or of an asymmetry, of the correlation matrix that rounding
#: to float32 by the sender explains.
PSD_TOLERANCE = 1e-7
#: Smallest variance of a velocity [m^2/s^2, rad^2/s^2] that is not exact: a picometre per second.
#: Products of three, times 1 ns squared, are still far from the smallest float.
MIN_VELOCITY_VARIANCE = 1e-24
#: Largest ratio of the variances in x and y: when turned by the heading, a float cannot hold both.
MAX_VARIANCE_RATIO = 1e15


def is_definite(P: Array) -> bool:
    """Return whether P (d, d) is positive definite beyond rounding, independent of its units."""
    if np.count_nonzero(P) == len(P):
        # If there are no zeros on the diagonal, all others are zero: usual in odometry.
        return all(0.0 < variance < math.inf for variance in P.diagonal().tolist())
    L, info = dpotrf(P, lower=1)
    # The determinant of the correlation matrix is at most e times its smallest eigenvalue.
    ratios = zip(L.diagonal().tolist(), P.diagonal().tolist())
    if info == 0 and math.prod(a * a / b for a, b in ratios) > math.e * MIN_CORRELATION_EIGENVALUE:
        return True
    variances = P.diagonal()
    if variances.min() <= 0.0:
        return False
    sigma = np.sqrt(variances)
    scale = sigma[:, None] * sigma
    # No correlation exceeds 1; divided by tiny variances it may be no number.
    if (np.abs(P) / 2.0 > scale).any():
        return False
    correlation = P / scale - MIN_CORRELATION_EIGENVALUE * np.eye(len(P))
    return int(dpotrf(correlation, lower=1)[1]) == 0


def is_semidefinite(P: Array) -> bool:
    """Return whether P (d, d) is positive semi-definite up to `PSD_TOLERANCE`."""
    variances = P.diagonal()
    scale = np.where(variances > 0.0, variances, 1.0)
    return bool(variances.min() >= 0.0) and is_definite(P + PSD_TOLERANCE * np.diag(scale))


def has_information(P: Array) -> bool:
    """Return whether the covariance P (3, 3) of a velocity can be inverted in any frame."""
    variances = P.diagonal().tolist()
    linear = variances[:2]
    return (
        min(variances) >= MIN_VELOCITY_VARIANCE
        and max(linear) <= MAX_VARIANCE_RATIO * min(linear) and is_definite(P))


def are_definite(P: Array) -> Flags:
    """Return `is_definite` of each of m covariances (m, d, d)."""
    variances = np.einsum('mii->mi', P)
    definite: Flags = (variances > 0.0).all(axis=1)
    sigma = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    scale = sigma[:, :, None] * sigma[:, None, :]
    # No correlation exceeds 1; divided by tiny variances it may be no number.
    definite &= ~(np.abs(P) / 2.0 > scale).any(axis=(1, 2))
    correlation = P[definite] / scale[definite]
    definite[definite] = np.linalg.eigvalsh(correlation)[:, 0] > MIN_CORRELATION_EIGENVALUE
    return definite
