# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry of a whole run as one trajectory, also without its systematic errors."""

from collections.abc import Sequence

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.geometry import Array, Stamps, wrap_all
from fej_slam_ros.core.records import NS, Odometry


def trajectory(odometry: Sequence[Odometry]) -> tuple[Stamps, Array]:
    """Return the stamps (n,) [ns] of odometry in order, each once, and the poses (n, 3)."""
    stamps = np.array([record.stamp for record in odometry], np.int64)
    poses = np.array([record.pose for record in odometry]).reshape(-1, 3)
    stamps, first = np.unique(stamps, return_index=True)
    return stamps, poses[first]


def corrected_trajectory(stamps: Stamps, poses: Array, values: Array) -> Array:
    """Return the odometry poses (n, 3) at stamps (n,) [ns] without errors (3,)."""
    distance, turn, bias = values
    ahead, left, turned = models.h_pose(poses[:-1], poses[1:]).T
    turns = turn * turned - bias * np.diff(stamps) / NS
    headings = poses[0, 2] + np.append(0.0, np.cumsum(turns))
    c, s = np.cos(headings[:-1]), np.sin(headings[:-1])
    x, y = (
        start + distance * np.append(0.0, np.cumsum(steps)) for start, steps in (
            (poses[0, 0], c * ahead - s * left), (poses[0, 1], s * ahead + c * left)))
    return np.column_stack([x, y, wrap_all(headings)])
