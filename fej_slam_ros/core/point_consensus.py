# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Consensus of two sets of points about the rigid motion between them.

Each point, with the one farthest from it, gives a rigid motion; the motion that carries most
points closest to their places in the other set decides.
"""

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.geometry import Array

#: Share of the landmarks of two maps that may contradict the others.
MAX_OUTLYING = 0.2
#: A landmark or rendezvous point is an outlier if its squared Mahalanobis distance is above this:
#: a correct one exceeds it with probability 1e-6.
OUTLIER_D2 = chi_square_limit(2, 1e-6)


def farthest_points(a: Array, b: Array, most: int) -> list[int]:
    """Return the rows of some of the points a, b (L, 2): those that fit the others least."""
    if not most:
        return []
    x, y = (points @ [1.0, 1.0j] for points in (a, b))
    far = np.abs(y[:, None] - y).argmax(axis=1)
    turn = (x[far] - x) * np.conj(y[far] - y)
    turn /= np.maximum(np.abs(turn), np.finfo(float).tiny)
    # Row k is of the motion by point k and the one farthest from it.
    distances = np.abs(x[:, None] + turn[:, None] * (y - y[:, None]) - x)
    best = np.partition(distances, -most - 1, axis=1)[:, -most - 1].argmin()
    rows: list[int] = np.argsort(distances[best])[-most:].tolist()
    return rows
