# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Innovations of robots whose headings are uncertain by more than a linear error describes.

A robot whose heading is off by d is so on an arc around the place where it was last known: its
position and with it the linear error e of an observation turn by -d / 2. So the innovation is
V(-d) e, with V of the exponential map of SE(2), and not e. Its distance is that of the most likely
e and d, by Gauss-Newton.
"""

import math

import numpy as np

from fej_slam_ros.core.geometry import Array, perpendicular

#: Iterations of a distance and, at least, of an update by an observation that passes the gate by
#: it; the first one is linear.
ITERATIONS = 5


def curved_distances(r: Array, R: Array, H: Array, P: Array) -> Array:
    """
    Return the squared distances (m,) of innovations whose errors lie on arcs.

    Parameters
    ----------
    r : (m, 2) array, innovations
    R : (m, 2, 2) array, the noise of each observation
    H : (m, 2, 5) array, Jacobians by the observer's pose and the observed point
    P : (m, 5, 5) array, covariances of these

    """
    # e and d are linear in the errors of pose and point.
    A = np.concatenate([H, np.broadcast_to(np.eye(5)[2], (len(r), 1, 5))], axis=1)
    Y = A @ P @ A.transpose(0, 2, 1)
    y = np.zeros((len(r), 3))
    for _ in range(ITERATIONS):
        half = -0.5 * y[:, 2]
        c, s = np.sinc(half / math.pi)[:, None] * (np.cos(half)[:, None], np.sin(half)[:, None])
        e = c * y[:, :2] + s * perpendicular(y[:, :2])
        B = np.stack([
            np.hstack([c, s]), np.hstack([-s, c]), -0.5 * perpendicular(e)], axis=2)
        BY = B @ Y
        S_y = BY @ B.transpose(0, 2, 1) + R
        u = r - e + np.einsum('kij,kj->ki', B, y)
        solved = np.linalg.solve(S_y, u[..., None])
        y = (BY.transpose(0, 2, 1) @ solved)[..., 0]
    distances: Array = np.einsum('ki,ki->k', u, solved[..., 0])
    return distances
