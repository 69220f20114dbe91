# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
How states outside an active submap follow from those inside.

Where no error changes with the estimate, errors outside are C g, with the whitened errors g of the
submap at the start, its proxies.

With the invariant filter, a correction dx_B of a point outside turns it with a robot, its owner:

    df = V(theta) dx_B,  f <- f + df,  e_B <- e_B + J df theta_o,

where theta is the correction of the owner's heading and theta_o its error after it. Then errors
outside are C g + sum_k J df_k theta_o,k: each correction adds a proxy for each owner, a copy of
the error of its heading.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from fej_slam_ros.core.ekf.covariance import Transport
from fej_slam_ros.core.ekf.matrix_product import product
from fej_slam_ros.core.ekf.symmetric_matrix import add_products, SymmetricMatrix
from fej_slam_ros.core.ekf.whitening import pivoted_root
from fej_slam_ros.core.geometry import Array, Indices, mean_rotation, perpendicular
from fej_slam_ros.core.pieces import pause


class OutsidePoints:
    """Points outside, here of a filter whose errors do not change with the estimate."""

    are_turned = False  #: whether corrections turn them, which may let their covariance grow

    def turn(self, dx: Array, A: Transport) -> Iterator[tuple[int, Array]]:
        """Turn no point."""
        return iter(())

    def correction(self, states: Indices | slice, C: Array, dg: Array) -> Array:
        """Return by how much k states are corrected, given C (rows, p) and dg (p,)."""
        return C[states] @ dg

    def change(
        self, C: Array, D: Array, first: Array, may_end: bool
    ) -> Callable[[SymmetricMatrix], None]:
        """
        Return a function that adds C D C^T to a matrix.

        D (p, p) is the change of the proxies' covariance, minus what was learnt, of rank r; their
        `first` variances (p,) are 1. This takes p^3 / 3 + 2 n p r flops, then n^2 r. If it may end
        early, it raises EndedError then.

        """
        learnt = -D
        pause()
        root, _ = pivoted_root(learnt)
        pause()
        W = product(root.T, C.T, may_end).T  # in Fortran order
        return partial(SymmetricMatrix.subtract_product, W=W)

    def added_flops(self, n: int) -> int:
        """Return the flops by which `change` of n states takes longer than without copies."""
        return 0

    def remove(self, states: Indices, place: Indices) -> None:
        """Remove some states; `place` (n,) has the new index of each other one."""


class TurningPoints(OutsidePoints):
    """
    Points outside that corrections turn with robots.

    Parameters
    ----------
    points : (l, 2) array, the states of all points
    owners : the robot that each of them turns with, ``''`` if it does not turn
    rows : number of rows of C

    """

    are_turned = True

    def __init__(self, points: Indices, owners: Sequence[str], rows: int) -> None:
        self._owners = sorted({*owners})
        self._points = points
        self._owner_of = np.array([self._owners.index(owner) for owner in owners], np.intp)
        self._dx = np.zeros(rows)  #: sum of the corrections, as turned
        self._copies = 0  #: number of proxies that are copies of headings

    def turn(self, dx: Array, A: Transport) -> Iterator[tuple[int, Array]]:
        """
        Turn the points as an update turned those of the submap.

        Their correction before they are turned is dx (rows,). Yields each heading that some of
        them turn with, and J df (rows, 1) of these.

        """
        heading_of = [A.heading_of(owner) for owner in self._owners]
        headings = sorted({heading for heading in heading_of if heading is not None})
        theta = np.array([0.0 if heading is None else A.dx[heading] for heading in heading_of])
        df = mean_rotation(theta, self._owner_of, dx[self._points])
        self._dx[self._points] += df
        # Points whose owners have left turn with one heading.
        for heading in headings:
            own = np.array([heading == other for other in heading_of])[self._owner_of]
            J_df = np.zeros((len(dx), 1))
            J_df[self._points[own], 0] = perpendicular(df[own])
            self._copies += 1
            yield heading, J_df

    def correction(self, states: Indices | slice, C: Array, dg: Array) -> Array:
        """Return by how much k states are corrected, which `turn` has added up."""
        return self._dx[states]

    def change(
        self, C: Array, D: Array, first: Array, may_end: bool
    ) -> Callable[[SymmetricMatrix], None]:
        """Return the same with copies of headings, whose first variances are 0."""
        g, copies = np.flatnonzero(first), np.flatnonzero(first == 0.0)
        learn = super().change(C[:, g], D[np.ix_(g, g)], first[g], may_end)
        # C D C^T = C_g D_gg C_g^T + V B^T + B V^T with V = C_c, B = C_g D_gc + 1/2 C_c D_cc.
        V, D_c = np.asfortranarray(C[:, copies]), D[:, copies]
        D_c[copies] *= 0.5
        B = product(D_c.T, C.T, may_end).T

        def apply(matrix: SymmetricMatrix) -> None:
            learn(matrix)
            add_products(matrix, V, B)
        return apply

    def added_flops(self, n: int) -> int:
        """Return the flops by which `change` of n states takes longer: copies count twice."""
        return n * n * self._copies

    def remove(self, states: Indices, place: Indices) -> None:
        """Remove some states; `place` (n,) has the new index of each other one."""
        kept = ~np.isin(self._points[:, 0], states)
        self._points, self._owner_of = place[self._points[kept]], self._owner_of[kept]
        self._dx = np.delete(self._dx, states[states < len(self._dx)])
