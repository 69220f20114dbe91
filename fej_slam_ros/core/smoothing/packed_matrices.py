# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Symmetric matrices (3, 3) of poses as their elements xx, xy, yy, x phi, y phi, phi phi.

Arithmetic on one element of all m matrices is an order faster than on one matrix after another.
"""

from collections.abc import Sequence

import numpy as np

from fej_slam_ros.core.geometry import Array

#: Rows and columns of the elements, and the element at each place of a matrix.
ELEMENT_ROWS, ELEMENT_COLUMNS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
POSITIONS = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5]])

#: The six elements, (m,) arrays, perhaps as one (6, m) array.
Elements = Array | Sequence[Array]


def packed(P: Array) -> Array:
    """Return the elements (6, m) of matrices (m, 3, 3)."""
    return np.ascontiguousarray(P[:, ELEMENT_ROWS, ELEMENT_COLUMNS].T)


def unpacked(elements: Array) -> Array:
    """Return the matrices (m, 3, 3) of elements (6, m)."""
    P: Array = elements[POSITIONS].transpose(2, 0, 1)
    return P


def inverse(elements: Elements) -> Array:
    """Return the elements (6, m) of the inverses; LinAlgError if a matrix is singular."""
    xx, xy, yy, x_phi, y_phi, phi_phi = elements
    adjugate = np.stack([
        yy * phi_phi - y_phi * y_phi, x_phi * y_phi - xy * phi_phi,
        xx * phi_phi - x_phi * x_phi, xy * y_phi - yy * x_phi,
        xy * x_phi - xx * y_phi, xx * yy - xy * xy])
    determinants = xx * adjugate[0] + xy * adjugate[1] + x_phi * adjugate[3]
    if not determinants.all():
        raise np.linalg.LinAlgError('a determinant is zero')
    inverse: Array = adjugate / determinants
    return inverse


def quadratic(elements: Elements, x: Array, y: Array, phi: Array) -> float:
    """Return the sum of r^T M r over all matrices M and vectors r = (x, y, phi)."""
    xx, xy, yy, x_phi, y_phi, phi_phi = elements
    return float(
        x @ (xx * x + 2.0 * (xy * y + x_phi * phi)) + y @ (yy * y + 2.0 * y_phi * phi)
        + phi @ (phi_phi * phi))


def rotated(elements: Elements, c: Array, s: Array) -> Sequence[Array]:
    """Return the elements of G P G^T, with G = diag(C, 1) of angles with cosine c and sine s."""
    xx, xy, yy, x_phi, y_phi, phi_phi = elements
    cc, cs, ss = c * c, c * s, s * s
    return (
        cc * xx - 2.0 * cs * xy + ss * yy, cs * (xx - yy) + (cc - ss) * xy,
        ss * xx + 2.0 * cs * xy + cc * yy, c * x_phi - s * y_phi, s * x_phi + c * y_phi, phi_phi)


def transported(elements: Elements, dx: Array, dy: Array) -> Sequence[Array]:
    """Return the elements of Phi P Phi^T, with the transition Phi over a displacement [m]."""
    xx, xy, yy, x_phi, y_phi, phi_phi = elements
    to_x_phi, to_y_phi = x_phi - dy * phi_phi, y_phi + dx * phi_phi
    return (
        xx - dy * (x_phi + to_x_phi), xy + dx * to_x_phi - dy * y_phi,
        yy + dx * (y_phi + to_y_phi), to_x_phi, to_y_phi, phi_phi)
