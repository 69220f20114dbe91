# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry that cannot be motion is found; motion of any ground robot is not."""

import numpy as np
import pytest

from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.ordering.impossible_motion import (
    impossible_motion, is_at_origin, Speeds, speeds, UNKNOWN_SPEEDS)
from fej_slam_ros.core.settings import RobotSettings
from helpers.records import odometry

R1 = RobotSettings('r1', 1)
Q = np.diag([1e-4, 1e-4, 1e-4])
AT_1_M_PER_S = Speeds(1.0, 0.5)


def reason(p0, p1, dt=0.1, before=AT_1_M_PER_S, noise=Q, limits=R1):
    """Return why the motion from one pose to another is impossible."""
    end = odometry('r1', 1000, p1)
    now = speeds(between(np.array(p0, float), end.pose), dt)
    return impossible_motion(now, noise, dt, end, before, limits)


@pytest.mark.parametrize(('pose', 'expected'), [
    ((0.0, 0.0, 0.0), True), ((0.009, 0.0, -0.009), True), ((0.0, 0.0, 2.0 * np.pi), True),
    ((0.02, 0.0, 0.0), False), ((0.0, 0.0, 0.02), False)])
def test_a_robot_at_the_origin_of_its_odometry_has_not_moved(pose, expected):
    assert is_at_origin(odometry('r1', 0, pose)) == expected


@pytest.mark.parametrize(('p1', 'expected'), [
    ((43.0, 6.0, 0.0), 'its odometry moved 33.0 m in 0.10 s'),
    ((10.0, 9.0, 0.0), 'its odometry moved 3.0 m in 0.10 s'),
    ((10.1, 6.0, 2.5), 'its odometry turned 2.5 rad in 0.10 s'),
    ((0.0, 0.0, 0.0), 'its odometry moved 11.7 m in 0.10 s')])
def test_a_jump_is_no_motion(p1, expected):
    assert reason((10.0, 6.0, 0.0), p1) == expected


def test_odometry_that_begins_again_at_zero_is_no_motion_even_if_near():
    assert reason((0.8, 0.6, 0.1), (0.0, 0.0, 0.0)) == (
        'its odometry began again at zero, 1.0 m away')
    assert reason((0.0, 0.0, 1.5), (0.0, 0.0, 0.0)) == (
        'its odometry began again at zero, 0.0 m away')
    assert not reason((0.8, 0.6, 0.1), (0.1, 0.0, 0.0))
    assert not reason((0.0, 0.0, 1.5), (0.0, 0.0, 0.1))


def test_odometry_that_begins_at_zero_after_a_gap_is_that_of_a_driver_that_was_off():
    assert reason((4.0, 3.0, 0.1), (0.0, 0.0, 0.0), dt=20.0) == (
        'its odometry began again at zero, 5.0 m away')
    assert not reason((4.0, 3.0, 0.1), (0.0, 0.0, 0.0), dt=1.8, before=Speeds(2.0, 0.5))
    assert not reason((4.0, 3.0, 0.1), (0.1, 0.0, 0.0), dt=20.0)
    # A robot that stood near where its odometry began.
    assert not reason((0.2, 0.0, 0.1), (0.0, 0.0, 0.0), dt=20.0)


@pytest.mark.parametrize(('distance', 'turn', 'dt', 'before'), [
    (3.6, 0.3, 0.1, Speeds(35.0, 3.0)),   # a car at 130 km/h
    (0.0, 0.0, 0.1, Speeds(10.0, 0.0)),   # that hits a wall
    (0.4, 0.6, 0.02, Speeds(5.0, 8.0)),   # a fast robot that turns, at 50 Hz
    (0.5, 0.1, 1e-3, Speeds(5.0, 1.0)),   # 0.1 s of motion in a burst of messages
    (4.0, 0.5, 0.1, UNKNOWN_SPEEDS),             # the first increment
    (60.0, 3.0, 60.0, AT_1_M_PER_S),      # after a gap of a minute
])
def test_the_motion_of_a_ground_robot_is_possible(distance, turn, dt, before):
    assert not reason((0.0, 5.0, 0.0), (distance, 5.0, turn), dt, before)


def test_a_robot_may_return_to_the_origin_of_its_odometry():
    assert not reason((-0.4, 0.0, 0.0), (0.0, 0.0, 0.0), 0.1, Speeds(4.0, 0.0))


def test_odometry_that_states_its_uncertainty_is_used():
    assert reason((10.0, 6.0, 0.0), (14.0, 6.0, 0.0))
    assert not reason((10.0, 6.0, 0.0), (14.0, 6.0, 0.0), noise=np.diag([1.0, 1.0, 0.01]))
    assert reason((10.0, 6.0, 0.0), (10.0, 6.0, 2.5))
    assert not reason((10.0, 6.0, 0.0), (10.0, 6.0, 2.5), noise=np.diag([0.01, 0.01, 1.0]))


def test_the_limits_are_those_of_the_robot():
    slow = RobotSettings('r1', 1, max_speed=2.0, max_turn_rate=1.0)

    assert reason((10.0, 6.0, 0.0), (10.8, 6.0, 0.0), limits=slow)
    assert reason((10.0, 6.0, 0.0), (10.0, 6.0, 0.5), limits=slow)
    assert not reason((10.0, 6.0, 0.0), (10.3, 6.0, 0.1), limits=slow)
