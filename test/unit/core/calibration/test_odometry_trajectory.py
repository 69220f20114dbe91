# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The odometry of a run, with and without systematic errors."""

import numpy as np
from numpy.testing import assert_allclose

from fej_slam_ros.core.calibration.odometry_trajectory import OdometryTrajectory
from fej_slam_ros.core.geometry import wrap
from fej_slam_ros.core.records import NS, Odometry


def test_motions_of_more_than_half_a_turn_keep_their_angle():
    """Of a robot that turns by 2 rad/s in place."""
    odometry = [
        Odometry('r', k * NS // 10, np.array([0.0, 0.0, wrap(0.2 * k)]), None) for k in range(101)]
    begins, ends = np.array([0, NS, 2 * NS]), np.array([3 * NS, NS, 9 * NS])
    trajectory = OdometryTrajectory.of(odometry)

    # Of sums of 100 angles, to their rounding.
    assert_allclose(trajectory.motions(begins, ends)[:, 2], [6.0, 0.0, 14.0], atol=1e-12)
    without = trajectory.without_errors(np.array([1.0, 0.5, 0.1]))
    assert_allclose(without.motions(begins, ends)[:, 2], [2.7, 0.0, 6.3], atol=1e-12)
