# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Information matrix of poses and landmarks at a linearisation point, and marginal covariances.

Covariances of a few variables follow from the rows of the Cholesky factor that the elimination
reaches from them; those of all variables by Takahashi's recursion, which computes the inverse
where the factor is not zero, from the last node of the elimination to the first.
"""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csc_array

from fej_slam_ros.core.geometry import Array, Indices, runs
from fej_slam_ros.core.smoothing.chain_reduction import ReducedChains
from fej_slam_ros.core.smoothing.inverse_blocks import InverseBlocks
from fej_slam_ros.core.smoothing.normal_equations import Cholesky

#: In place of a row: the coordinate of a fixed pose, and that of a pose within a chain.
FIXED, ELIMINATED = -1, -2


class Information:
    """
    Information matrix A^T A of poses and landmarks.

    Fixed poses are not part of it; their covariance is zero. Neither are the poses within chains
    of odometry, of which only `marginals` gives the covariance.

    Attributes
    ----------
    coordinates : (u,) array, coordinate of each row; coordinates are counted pose by pose
        (x, y, phi), then landmark by landmark (x, y)
    matrix : (u, u) sparse array, in the order of elimination

    """

    def __init__(
        self, matrix: csc_array, coordinates: Indices, poses: int, points: int,
        chains: ReducedChains,
    ) -> None:
        """Factor the matrix; raise SingularError if it does not determine all variables."""
        self.matrix, self.coordinates = matrix, coordinates
        self._poses, self._points, self._chains = poses, points, chains
        self._factor = Cholesky(matrix)
        self._rows = np.full(3 * poses + 2 * points, FIXED)
        self._rows[_coordinates(chains.chains.eliminated, 3)] = ELIMINATED
        self._rows[coordinates] = np.arange(len(coordinates))

    def square_root(self) -> tuple[csc_array, Indices]:
        """
        Return the square-root information.

        Returns
        -------
        R_sqrt : (u, u) sparse array, upper triangular, R_sqrt^T R_sqrt = A^T A
        coordinates : (u,) array, coordinate of each of its columns

        """
        return self._factor.square_root(), self.coordinates[self._factor.order]

    def joint(self, poses: Sequence[int] = (), points: Sequence[int] = ()) -> Array:
        """
        Return the joint covariance (3 k + 2 m, 3 k + 2 m) of k poses and m landmarks.

        In the order of the given indices, poses first, and in the frame of the estimate. No pose
        may be within a chain.

        """
        wanted = np.concatenate([
            _coordinates(np.array(poses, np.intp), 3),
            3 * self._poses + _coordinates(np.array(points, np.intp), 2)])
        rows = self._rows[wanted]
        if (rows == ELIMINATED).any():
            raise ValueError('a pose was eliminated: keep it in the information')
        free = np.flatnonzero(rows != FIXED)
        P = np.zeros((len(wanted), len(wanted)))
        P[free[:, None], free] = self._factor.inverse_at(rows[free])
        return P

    def marginals(self) -> tuple[Array, Array]:
        """Return the covariances of every pose (n, 3, 3) and of every landmark (l, 2, 2)."""
        poses, points = np.zeros((self._poses, 3, 3)), np.zeros((self._points, 2, 2))
        coordinates, first_point = self.coordinates[self._factor.order], 3 * self._poses
        node_of_row = np.where(
            coordinates < first_point, coordinates // 3,
            self._poses + (coordinates - first_point) // 2)
        firsts = np.flatnonzero(np.diff(node_of_row, prepend=-1))
        nodes, sizes = node_of_row[firsts], np.diff(firsts, append=len(node_of_row))
        first_rows = np.full(self._poses + self._points, -1)
        first_rows[nodes] = firsts
        ends = _ChainEnds(*self._chains.chains.nodes, first_rows)
        for group in self._factor.inverse_blocks(sizes):
            if group.Z.shape[1] == poses.shape[1]:
                poses[nodes[group.blocks]] = group.Z
            else:
                points[nodes[group.blocks] - self._poses] = group.Z
            ends.add(group, firsts[group.blocks])
        a, b = self._chains.chains.nodes
        poses[self._chains.chains.eliminated] = self._chains.marginals(
            poses[a], ends.P_ab, poses[b])
        return poses, points


class _ChainEnds:
    """
    Covariances between the poses at both ends of each chain.

    Attributes
    ----------
    P_ab : (c, 3, 3) array; zero where one of the poses is fixed

    """

    def __init__(self, a: Indices, b: Indices, first_rows: Indices) -> None:
        """Find the chains from poses a to b by their first rows in the factor, -1 if fixed."""
        self.P_ab = np.zeros((len(a), 3, 3))
        rows = np.stack([first_rows[a], first_rows[b]])
        self._chains = np.argsort(rows.min(axis=0), kind='stable')
        self._earlier, self._later = np.sort(rows[:, self._chains], axis=0)
        self._is_a_later = rows[0, self._chains] > rows[1, self._chains]

    def add(self, group: InverseBlocks, first_rows: Indices) -> None:
        """Take the covariances of the chains whose earlier poses are blocks (g,) of a group."""
        begin = np.searchsorted(self._earlier, first_rows)
        count = np.searchsorted(self._earlier, first_rows, 'right') - begin
        k, block = runs(begin, count), np.repeat(np.arange(len(first_rows)), count)
        if len(k):
            at = np.argmax(group.rows[block] == self._later[k, None], axis=1)
            P = group.Z_linked[block[:, None], at[:, None] + np.arange(3)]
            P_ab = np.where(self._is_a_later[k, None, None], P, P.transpose(0, 2, 1))
            self.P_ab[self._chains[k]] = P_ab


def _coordinates(nodes: Indices, size: int) -> Indices:
    """Return the stacked coordinates of nodes of one size."""
    return (size * nodes[:, None] + np.arange(size)).ravel()
