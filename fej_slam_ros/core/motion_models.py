# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Velocity and range-bearing measurements as increments and Cartesian observations.

In the constant-turn model with lateral slip, eqs. (4) to (10) of [Andersson], the increment U
depends on the velocities only. Its noise is constant in the frame of the earlier pose: there Q is
Lambda of eq. (10), so that the model is an odometry increment like any other.
"""

from collections.abc import Mapping
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation, wrap_all
from fej_slam_ros.errors import UserError

#: Turn [rad] below which three terms of a series are more accurate than a difference.
SMALL_TURN = 0.05


def arc_poses(lengths: Array, turns: Array) -> Array:
    """Return the poses (n + 1, 3) along n arcs by their lengths [m] and turns [rad], from zero."""
    headings = np.append(0.0, np.cumsum(turns))
    chords, directions = lengths * np.sinc(turns / math.tau), headings[:-1] + turns / 2.0
    x, y = (
        np.append(0.0, np.cumsum(chords * function(directions))) for function in (np.cos, np.sin))
    return np.column_stack([x, y, wrap_all(headings)])


def constant_turn(u: Array, sigma: Array, T: float) -> tuple[Array, Array]:
    """
    Return the increment of constant velocities, and its covariance.

    Parameters
    ----------
    u : (3,) array, velocities v ahead and v_lat to the left [m/s], omega [rad/s], eq. (4)
    sigma : (3,) array, their standard deviations [m/s, m/s, rad/s]
    T : duration [s]

    Returns
    -------
    U : (3,) array, the pose after T in the frame of the earlier pose, eq. (7) [m, m, rad]
    Q : (3, 3) array, covariance of U in that frame, eq. (10)

    Raises
    ------
    UserError
        Q would be singular: a standard deviation or T is not positive, or the robot makes a full
        turn within T.

    """
    _require_positive(dict(zip(('sigma_v', 'sigma_v_lat', 'sigma_omega'), sigma)) | {'T': T})
    v, v_lat, omega = u
    theta = omega * T
    if abs(theta) >= 2.0 * math.pi:
        raise UserError(
            f'omega {omega:g} rad/s turns the robot by a whole turn within T = {T:g} s;'
            ' take a shorter T')
    half = np.sinc(theta / (2.0 * np.pi))
    # sin(theta) / theta and (1 - cos(theta)) / theta, and their derivatives.
    s, c = np.sinc(theta / np.pi), theta / 2.0 * half**2
    ds, dc = _slope(theta, s), s - half**2 / 2.0
    U = np.array([T * (v * s - v_lat * c), T * (v * c + v_lat * s), theta])
    G = T * np.array([
        [s, -c, T * (v * ds - v_lat * dc)],
        [c, s, T * (v * dc + v_lat * ds)],
        [0.0, 0.0, 1.0]])
    root = G * sigma
    return U, root @ root.T


def polar(r: float, beta: float, sigma_r: float, sigma_beta: float) -> tuple[Array, Array]:
    """
    Return the Cartesian observation of a range and a bearing.

    R is the mean squared error of z, also where the bearing is so coarse that the position is on
    an arc. Its approximation to first order, eq. (14) of [Andersson], is too small along the line
    of sight there.

    Parameters
    ----------
    r, beta : range [m] and bearing [rad, to the left], eq. (11) of [Andersson]
    sigma_r, sigma_beta : the standard deviations of their normal errors [m, rad]

    Returns
    -------
    z : (2,) array, observed position in the frame of the robot [m], eq. (12)
    R : (2, 2) array, covariance of z

    Raises
    ------
    UserError
        R would be singular: the range or a standard deviation is not positive.

    """
    _require_positive({'range r': r, 'sigma_r': sigma_r, 'sigma_beta': sigma_beta})
    z = r * rotation(beta)[:, 0]
    mean, P = polar_moments(r, beta, sigma_r, sigma_beta)
    return z, P + np.outer(mean - z, mean - z)


def polar_moments(
    r: float, beta: float, sigma_r: float, sigma_beta: float
) -> tuple[Array, Array]:
    """Return mean (2,) and covariance (2, 2) of r [cos(beta), sin(beta)], r and beta normal."""
    C, a = rotation(beta), sigma_beta * sigma_beta
    along = math.hypot(r * math.expm1(-a), sigma_r * math.sqrt(1.0 + math.exp(-2.0 * a)))
    across = math.hypot(r, sigma_r) * math.sqrt(-math.expm1(-2.0 * a))
    root = C * [along * math.sqrt(0.5), across * math.sqrt(0.5)]
    return math.exp(-0.5 * a) * r * C[:, 0], root @ root.T


def _slope(theta: float, s: float) -> float:
    """Return the derivative of s = sin(theta) / theta."""
    if abs(theta) < SMALL_TURN:
        return -theta / 3.0 + theta**3 / 30.0 - theta**5 / 840.0
    return (math.cos(theta) - s) / theta


def _require_positive(values: Mapping[str, float]) -> None:
    for name, value in values.items():
        if not value > 0.0:
            raise UserError(f'{name} is {value:g}; it must be positive')
