# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Other states as combinations of the whitened errors of some states.

With P = L L^T, errors e = L g have whitened errors g of covariance I. The covariance of other
states with e is C L^T, so that they are C g and a rest that is independent of e. Rounding stays
that of P where all states share a large error, unlike with the inverse of P.
"""

import sys
from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpstrf

from fej_slam_ros.core.geometry import Array, Indices


class Whitening(NamedTuple):
    """A root of the covariance P (a, a) of some states, of rank g, and n others by it."""

    L: Array  #: (a, g) array with P = L L^T
    C: Array  #: (n, g) Fortran array with cross = C L^T
    pivots: Indices  #: (g,) array, the rows of L that are, in this order, a lower triangle

    def whitened(self, rows: Array) -> Array:
        """Return G (g, k) with L G = rows, given the pivot rows (g, k)."""
        if not len(self.pivots):
            return rows
        G: Array = dtrsm(1.0, self.L[self.pivots], rows, lower=1)
        return G


def whiten(P: Array, cross: Array, scale: Array) -> Whitening:
    """
    Return the whitening of some states, for n g^2 flops.

    Parameters
    ----------
    P : (a, a) array, a covariance of rank g within rounding
    cross : (n, a) array, the covariance of other states with these
    scale : (a,) array, variances to whose rounding elements of P are known

    """
    sigma = np.sqrt(np.where(scale > 0.0, scale, 1.0))
    root, pivots = pivoted_root(P / (sigma[:, None] * sigma), len(P) * sys.float_info.epsilon)
    L: Array = sigma[:, None] * root
    if not len(pivots):
        return Whitening(L, np.zeros((len(cross), 0), order='F'), pivots)
    C: Array = dtrsm(1.0, L[pivots], cross[:, pivots], side=1, lower=1, trans_a=1)
    return Whitening(L, C, pivots)


def pivoted_root(P: Array, tolerance: float = -1.0) -> tuple[Array, Indices]:
    """Return a root (a, p) of a positive semidefinite P (a, a) of rank p, and its pivots (p,)."""
    L, pivots, rank, _ = dpstrf(P, tol=tolerance, lower=1)
    root, order = np.zeros((len(L), rank)), np.arange(len(L))
    # The lower triangle of L; np.tril takes longer for a few rows.
    root[pivots - 1] = np.where(order[:, None] >= order[:rank], L[:, :rank], 0.0)
    return root, pivots[:rank] - 1
