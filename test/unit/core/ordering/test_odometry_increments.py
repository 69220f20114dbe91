# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Increments between odometry records, and their division at scans."""

from math import cos, pi, sin

import numpy as np
import pytest

from fej_slam_ros.core.ordering.impossible_motion import Speeds, UNKNOWN_SPEEDS
from fej_slam_ros.core.ordering.odometry_increments import (
    increment, OdometryIncrements, split, unknown_motion)
from fej_slam_ros.core.settings import RobotSettings
from helpers.records import MS, odometry, Q, Q_TURNED

SETTINGS = RobotSettings('r1', 1, odometry_sigma=(0.2, 0.1, 0.4))

ROUNDING = 1e-14


@pytest.mark.parametrize(('p0', 'p1', 'u'), [
    ((1.0, 2.0, pi / 2), (1.0, 5.0, pi), (3.0, 0.0, pi / 2)),
    ((0.0, 0.0, pi), (2.0, 1.0, pi / 2), (-2.0, -1.0, -pi / 2)),
    ((0.0, 0.0, 3.0), (0.0, 0.0, -3.0), (0.0, 0.0, 2.0 * pi - 6.0)),
    ((5.0, 0.0, -3.0), (6.0, 0.0, 3.0), (cos(3.0), sin(3.0), 6.0 - 2.0 * pi)),
])
def test_an_increment_is_given_in_the_frame_of_its_beginning(p0, p1, u):
    found, _ = increment(odometry('r1', 0, p0), odometry('r1', 100, p1), SETTINGS)

    np.testing.assert_allclose(found, u, atol=ROUNDING)


def test_an_increment_has_the_covariance_of_the_later_twist_times_its_duration_squared():
    earlier = odometry('r1', 1000, twist_covariance=np.eye(3))
    later = odometry('r1', 1500, twist_covariance=4.0 * Q)

    _, found = increment(earlier, later, SETTINGS)

    np.testing.assert_allclose(found, Q, rtol=ROUNDING)


def test_an_increment_of_unknown_covariance_has_sigma_per_square_root_of_a_second():
    earlier = odometry('r1', 1000, twist_covariance=np.eye(3))

    _, found = increment(earlier, odometry('r1', 1250), SETTINGS)

    np.testing.assert_allclose(found, np.diag([0.01, 0.0025, 0.04]), rtol=1e-12, atol=0.0)


def test_the_parts_of_an_increment_share_its_displacement_and_its_covariance():
    first, rest = split(np.array([4.0, 2.0, 2.0 * pi / 3.0]), Q, 0.75)

    np.testing.assert_allclose(first[0], [3.0, 1.5, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(first[1], 0.75 * Q, atol=ROUNDING)
    np.testing.assert_allclose(rest[0], [0.5, -1.0, pi / 6], atol=ROUNDING)
    np.testing.assert_allclose(rest[1], 0.25 * Q_TURNED, atol=ROUNDING)


@pytest.mark.parametrize('wrong', [1.6, 5.0])
def test_the_return_from_one_wrong_message_is_impossible_too(wrong):
    """At 20 Hz and 1 m/s a jump of 1.3 m is: 0.15 s with the error of a stamp, at 100 m/s^2."""
    increments = OdometryIncrements(SETTINGS)
    for k in range(8):
        increments.add(odometry('r1', 50 * k, (0.05 * k + (wrong if k == 3 else 0.0), 0.0, 0.0)))

    motions = [increments.advance(50 * k * MS) for k in range(8)]

    assert [bool(motion.impossible) for motion in motions[1:]] == [
        False, False, True, True, False, False, False]


@pytest.mark.parametrize('stamps', [(200, 300), (150, 200, 300), (150, 180, 200, 300)])
def test_a_jump_is_one_impossible_motion_and_the_motion_after_it_goes_on(stamps):
    increments = OdometryIncrements(RobotSettings('r1', 1))
    for ms, x in [(0, 0.0), (100, 0.1), (200, 30.0), (300, 30.1)]:
        increments.add(odometry('r1', ms, (x, 0.0, 0.0)))

    motions, poses = [], []
    for ms in (0, 100, *stamps):
        motions.append(increments.advance(ms * MS))
        poses.append(increments.pose[0])

    assert poses == [0.0, 0.1, *[30.0] * (len(stamps) - 1), 30.1]
    assert [motion.impossible for motion in motions[1:]] == [
        '', 'its odometry moved 29.9 m in 0.10 s', *[''] * (len(stamps) - 1)]
    np.testing.assert_allclose(motions[-1].u, [0.1, 0.0, 0.0], atol=1e-9)
    # What the robot did in the rest of the increment is unknown: at rest, to 1 m/s.
    for begin, end, motion in zip(stamps, stamps[1:-1], motions[3:-1]):
        np.testing.assert_array_equal(motion.u, np.zeros(3))
        assert motion.Q[0, 0] == pytest.approx(
            ((200 - stamps[0]) / 1000) ** 2 * (end - begin) / (200 - stamps[0]))


@pytest.mark.parametrize(('before', 'sigma'), [
    (Speeds(4.0, 0.5), [2.0, 2.0, 0.5]), (UNKNOWN_SPEEDS, [0.5, 0.5, 0.5])])
def test_an_unknown_motion_is_as_uncertain_as_the_speed_before_but_at_least_1_m_per_s(
        before, sigma):
    u, noise = unknown_motion(0.5, before)

    np.testing.assert_array_equal(u, np.zeros(3))
    np.testing.assert_allclose(noise, np.diag(np.square(sigma)))
