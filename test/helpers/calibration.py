# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated input of calibration, and the errors of its results."""

import math

from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from fej_slam_ros.ros.session import simulation


def simulated(seed, **changes):
    """Return simulated measurements without ground truth."""
    records = simulation.parse({'loops': 1, 'landmarks': 30, 'seed': seed, **changes}).records()
    return [r for r in records if isinstance(r, (Odometry, Scan, RobotScan))]


def received(records):
    """Return records without times of reception."""
    return [(record, None) for record in records]


def error(found, true):
    """Return the error of a factor in standard errors."""
    return abs(math.log(found.scale / true)) / found.relative_error
