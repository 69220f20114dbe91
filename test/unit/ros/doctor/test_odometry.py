# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.doctor.odometry import check
from fej_slam_ros.ros.doctor.survey import OdometrySeries


def found(x, stamps=None):
    """Return names of what is found in odometry of a robot at x (n,), by default ten a second."""
    if stamps is None:
        stamps = np.arange(len(x)) * NS // 10
    variances = [[1e-2, 1e-2, 1e-3]] * len(x)
    return [finding.name for finding in check('r1/odom', OdometrySeries(
        stamps.tolist(), stamps.tolist(), poses=[(at, 0.0, 0.0) for at in x.tolist()],
        variances=variances))]


def test_who_stands_for_a_minute_and_then_drives_does_not_jump():
    # 1.5 m/s for 2 s.
    assert found(np.maximum(0.0, np.arange(620) - 599.0) * 0.15) == []


@pytest.mark.parametrize('place', [1, 50, 99])
def test_who_stands_and_is_elsewhere_at_once_has_jumped(place):
    x = np.zeros(100)
    x[place:] = 0.5

    assert found(x) == ['jump']


def test_stamps_that_come_in_bursts_make_no_jump():
    k = np.arange(200)
    # Every fortieth message is stamped 0.1 ms after the one before it.
    stamps = k * NS // 10 - np.where(k % 40 == 39, NS // 10 - NS // 10_000, 0)

    assert found(0.1 * k, stamps) == []
