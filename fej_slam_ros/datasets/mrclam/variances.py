# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Variances that are sums of known quantities, from errors."""

import math

import numpy as np
from scipy.optimize import nnls

from fej_slam_ros.core.geometry import Array

#: Iterations of the reweighted least squares, enough to converge.
REWEIGHTINGS = 10


def variance_coefficients(
    errors: Array, A: Array, constant: float, expected: Array,
    relative_sigma: float = math.inf,
) -> Array:
    """
    Return c >= 0 (k,) so that squared errors (n,) are A @ c + constant in the mean.

    Each row counts by the variance that it states, as errors are normal.

    Parameters
    ----------
    errors : (n,) array
    A : (n, k) array, quantities with which the variances grow
    constant : part of all variances that is known
    expected : (k,) array, the sizes of c
    relative_sigma : standard deviation of c relative to them, where they are known

    """
    squares, k = np.square(errors), len(expected)
    # A squared error has sqrt(2) times its mean as standard deviation.
    weight = math.sqrt(2.0) / relative_sigma
    variances = np.full(len(squares), squares.mean() + constant)
    for _ in range(REWEIGHTINGS):
        ratios, _ = nnls(
            np.vstack([A * expected / variances[:, None], weight * np.eye(k)]),
            np.append((squares - constant) / variances, np.full(k, weight)))
        variances = A @ (expected * ratios) + constant
    c: Array = expected * ratios
    return c
