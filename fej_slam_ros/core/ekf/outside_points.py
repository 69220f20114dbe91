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
from fej_slam_ros.core.ekf.symmetric_matrix import add_products, SymmetricMatrix
from fej_slam_ros.core.ekf.whitening import pivoted_root
from fej_slam_ros.core.geometry import Array, Indices, mean_rotation, perpendicular, wrap_all
from fej_slam_ros.core.pieces import pause, product


class OutsidePoints:
    """Points outside, here of a filter whose errors do not change with the estimate."""

    are_turned = False  #: whether corrections turn them, which may let their covariance grow

    def turn(self, dx: Array, A: Transport) -> Iterator[tuple[int, Array]]:
        """Turn no point."""
        return iter(())

    def correction(self, states: Indices | slice, C: Array, dg: Array) -> Array:
        """Return by how much states are corrected, (k,), by C (rows, p) and dg of proxies (p,)."""
        dx: Array = C[states] @ dg
        return dx

    def change(
        self, C: Array, D: Array, first: Array, may_end: bool
    ) -> Callable[[SymmetricMatrix], None]:
        """
        Return what adds C D C^T to a matrix, for the change D (p, p) of the proxies' covariance.

        Their `first` variances (p,) are 1, and D is minus what was learnt, of rank r. This takes
        p^3 / 3 + 2 n p r flops, then n^2 r. If it may end early, it raises EndedError then.

        """
        learnt = -D
        pause()
        root, _ = pivoted_root(learnt)
        pause()
        W = product(root.T, C.T, may_end).T  # in Fortran order
        return partial(SymmetricMatrix.subtract_product, W=W)

    def remove(self, states: Indices) -> None:
        """Remove some states."""


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
        self._dx = np.zeros(rows)

    def turn(self, dx: Array, A: Transport) -> Iterator[tuple[int, Array]]:
        """
        Turn the points as A does those of the submap, by their correction dx (rows,) before.

        Yields the heading that the points of each owner turn with, and J df (rows, 1) of these.

        """
        headings = [A.heading_of(owner) for owner in self._owners]
        theta = np.array([0.0 if heading is None else A.dx[heading] for heading in headings])
        df = mean_rotation(wrap_all(theta), self._owner_of, dx[self._points])
        self._dx[self._points] += df
        for owner, heading in enumerate(headings):
            if heading is not None:
                own, J_df = self._owner_of == owner, np.zeros((len(dx), 1))
                J_df[self._points[own], 0] = perpendicular(df[own])
                yield heading, J_df

    def correction(self, states: Indices | slice, C: Array, dg: Array) -> Array:
        """Return by how much states are corrected, (k,), which `turn` has added up."""
        dx: Array = self._dx[states]
        return dx

    def change(
        self, C: Array, D: Array, first: Array, may_end: bool
    ) -> Callable[[SymmetricMatrix], None]:
        """Return the same with c copies, whose first variances are 0: 2 n^2 c flops more."""
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

    def remove(self, states: Indices) -> None:
        """Remove some states."""
        rows = np.arange(len(self._dx))
        kept, place = ~np.isin(self._points[:, 0], states), np.cumsum(~np.isin(rows, states)) - 1
        self._points, self._owner_of = place[self._points[kept]], self._owner_of[kept]
        self._dx = np.delete(self._dx, states[states < len(rows)])
