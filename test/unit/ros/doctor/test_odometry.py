# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Jumps of odometry."""

import numpy as np
import pytest

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.doctor.odometry import check
from fej_slam_ros.ros.doctor.survey import OdometrySeries


def findings_of(x, stamps=None):
    """Return the names of findings in odometry along x (n,), at 10 Hz by default."""
    if stamps is None:
        stamps = np.arange(len(x)) * NS // 10
    variances = [[1e-2, 1e-2, 1e-3]] * len(x)
    return [finding.name for finding in check('r1/odom', OdometrySeries(
        stamps.tolist(), stamps.tolist(), poses=[(at, 0.0, 0.0) for at in x.tolist()],
        variances=variances))]


def test_driving_after_a_minute_of_rest_is_not_a_jump():
    # 1.5 m/s for 2 s.
    assert findings_of(np.maximum(0.0, np.arange(620) - 599.0) * 0.15) == []


@pytest.mark.parametrize('index', [1, 50, 99])
def test_a_displaced_robot_at_rest_has_jumped(index):
    x = np.zeros(100)
    x[index:] = 0.5

    assert findings_of(x) == ['jump']


def test_stamps_in_bursts_are_not_jumps():
    k = np.arange(200)
    # Every fortieth message has a stamp 0.1 ms after the one before it.
    stamps = k * NS // 10 - np.where(k % 40 == 39, NS // 10 - NS // 10_000, 0)

    assert findings_of(0.1 * k, stamps) == []
