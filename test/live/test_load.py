# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A central node serves tens of robots over DDS without loss."""

import os
from unittest import mock

import pytest

from fej_slam_ros.benchmark.latency import live_time
from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.core.settings import Settings
from helpers.optional import optional

load_node = optional('fej_slam_ros.benchmark.live_load')

pytestmark = pytest.mark.ros


def run(load):
    """Run a load and print its result; the speed of the machine is not asserted."""
    with mock.patch.dict(os.environ):
        time = live_time(load, load_node.run_load(load), Settings.max_delay)
    print(time)  # noqa: T201
    return time


def assert_nothing_is_lost(time):
    assert time.sent == time.received == time.used
    assert time.steps == time.poses


@pytest.mark.slow
def test_a_small_load_is_served_without_loss():
    time = run(Load(robots=4, odometry_rate=20, seconds=3))

    assert_nothing_is_lost(time)
    # 80 odometry messages a second, 40 scans.
    assert (time.sent, time.poses) == (360, 240)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(('robots', 'odometry_rate'), [(20, 50), (50, 20)])
def test_two_minutes_of_a_large_team_are_served_without_loss(robots, odometry_rate):
    time = run(Load(robots, odometry_rate))

    assert_nothing_is_lost(time)
