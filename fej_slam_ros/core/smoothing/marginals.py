# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Information matrix of poses and landmarks at a linearisation point, and marginal covariances.

Covariances of a few variables are solved for column by column. Those of all variables are computed
at once in another order: consecutive poses form a band; landmarks, and poses with factors to other
than neighbouring poses, form its border. Eliminating the band first leaves the information of the
border.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse import csc_array

from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.smoothing.normal_equations import Cholesky

#: Columns of a covariance solved for at once; bounds the memory.
MAX_COLUMNS = 200
#: Subdiagonals of the band: a pose and the one before it.
BANDWIDTH = 5


class Information:
    """
    Information matrix A^T A of poses and landmarks.

    Fixed poses and landmarks are not part of it; their covariance is zero.

    Attributes
    ----------
    coordinates : (u,) array, coordinate of each row; coordinates are counted pose by pose
        (x, y, phi), then landmark by landmark (x, y)
    matrix : (u, u) sparse array, in the order of elimination

    """

    def __init__(self, matrix: csc_array, coordinates: Indices, poses: int, points: int) -> None:
        """Factor the matrix; raise SingularError if it does not determine all variables."""
        self.matrix, self.coordinates = matrix, coordinates
        self._poses, self._points = poses, points
        self._factor = Cholesky(matrix)
        self._rows = np.full(3 * poses + 2 * points, -1)
        self._rows[coordinates] = np.arange(len(coordinates))

    def square_root(self) -> tuple[csc_array, Indices]:
        """
        Return the square-root information.

        Returns
        -------
        R_sqrt : (u, u) sparse array, upper triangular, R_sqrt^T R_sqrt = A^T A
        coordinates : (u,) array, coordinate of each of its columns

        """
        R_sqrt, order = self._factor.square_root()
        return R_sqrt, self.coordinates[order]

    def joint(self, poses: Sequence[int] = (), points: Sequence[int] = ()) -> Array:
        """
        Return the joint covariance (3 k + 2 m, 3 k + 2 m) of k poses and m landmarks.

        In the order of the given indices, poses first, and in the frame of the estimate.

        """
        wanted = np.concatenate([
            _coordinates(np.array(poses, np.intp), 3),
            3 * self._poses + _coordinates(np.array(points, np.intp), 2)])
        rows = self._rows[wanted]
        free = np.flatnonzero(rows >= 0)
        P = np.zeros((len(wanted), len(wanted)))
        for columns in np.split(free, range(MAX_COLUMNS, len(free), MAX_COLUMNS)):
            unit = np.zeros((len(self.coordinates), len(columns)))
            unit[rows[columns], np.arange(len(columns))] = 1.0
            P[np.ix_(free, columns)] = self._factor.solve(unit)[rows[free]]
        return (P + P.T) / 2.0

    def marginals(self) -> tuple[Array, Array]:
        """
        Return the covariances of every pose (n, 3, 3) and of every landmark (l, 2, 2).

        The cost grows with the square of the number of landmarks and of poses that have factors
        to other than the neighbouring poses.

        """
        band, border = self._split()
        order = np.concatenate([band, border])
        N = self.matrix[:, self._rows[order]][self._rows[order]].tocsc()
        k = len(band)
        T, B, D = N[:k, :k], N[:k, k:].toarray(order='F'), N[k:, k:].toarray(order='F')
        L = _band_cholesky(T)
        # LAPACK rejects a band without rows.
        X = dpbtrs(L, B, lower=1)[0] if k > 0 else B
        C, _ = cho_factor(D - N[k:, :k] @ X, lower=True)
        # The band's estimate depends on the border's by -X.
        Y = dtrsm(1.0, C, X, side=1, lower=1, trans_a=1, overwrite_b=1)
        Y = Y.reshape(k // 3, 3, len(border))
        P_band = _band_inverse(L) + Y @ Y.transpose(0, 2, 1)
        # cho_solve of scipy 1.11 rejects a border without rows.
        P_border = cho_solve((C, True), np.eye(len(border))) if len(border) else D
        return self._gathered(band, P_band, border, P_border)

    def _split(self) -> tuple[Indices, Indices]:
        """Return the coordinates of the band and of the border."""
        pairs = self.matrix.tocoo()
        one, other = self.coordinates[pairs.row] // 3, self.coordinates[pairs.col] // 3
        in_border = np.zeros(len(self._rows), bool)
        poses = np.maximum(one, other) < self._poses
        distant = one[poses & (other < one - 1)]
        in_border[_coordinates(distant, 3)] = True
        in_border[3 * self._poses:] = True
        free = np.sort(self.coordinates)
        return free[~in_border[free]], free[in_border[free]]

    def _gathered(
        self, band: Indices, P_band: Array, border: Indices, P_border: Array
    ) -> tuple[Array, Array]:
        """Return the diagonal blocks by index of pose and of landmark."""
        poses, points = np.zeros((self._poses, 3, 3)), np.zeros((self._points, 2, 2))
        poses[band[::3] // 3] = P_band
        first = 3 * self._poses
        rows = np.flatnonzero(border < first).reshape(-1, 3)
        poses[border[rows[:, 0]] // 3] = P_border[rows[:, :, None], rows[:, None]]
        rows = np.flatnonzero(border >= first).reshape(-1, 2)
        points[(border[rows[:, 0]] - first) // 2] = P_border[rows[:, :, None], rows[:, None]]
        return poses, points


def _coordinates(nodes: Indices, size: int) -> Indices:
    """Return the stacked coordinates of nodes of one size."""
    return (size * nodes[:, None] + np.arange(size)).ravel()


def _band_cholesky(T: csc_array) -> Array:
    """Return the lower Cholesky factor of a band matrix in LAPACK's diagonal storage."""
    pairs = T.tocoo()
    lower = pairs.row >= pairs.col
    row, column = pairs.row[lower], pairs.col[lower]
    band = np.zeros((BANDWIDTH + 1, T.shape[0]), order='F')
    band[row - column, column] = pairs.data[lower]
    L: Array = dpbtrf(band, lower=1)[0]
    return L


def _band_inverse(L: Array) -> Array:
    """Return the diagonal blocks (k, 3, 3) of (L L^T)^-1 from the band of L."""
    # Backward recursion Z_i = A^-T (I + E^T Z_i+1 E) A^-1 with the diagonal blocks A and the
    # blocks E below them.
    k = L.shape[1] // 3
    A, E = np.zeros((k, 3, 3)), np.zeros((k, 3, 3))
    for row in range(3):
        for column in range(3):
            if row >= column:
                A[:, row, column] = L[row - column, column::3]
            E[:, row, column] = L[3 + row - column, column::3]
    inverse = np.linalg.solve(A, np.broadcast_to(np.eye(3), A.shape))
    Z = inverse.transpose(0, 2, 1) @ inverse
    K = E @ inverse
    for i in range(k - 2, -1, -1):
        Z[i] += K[i].T @ Z[i + 1] @ K[i]
    return Z
