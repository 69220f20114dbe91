# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The motion before the first odometry received: its covariance, and when it is unknown."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.ordering.missed_motion import missed_motion
from fej_slam_ros.core.records import Motion
from fej_slam_ros.core.settings import RobotSettings
from helpers.records import odometry

ROBOT = RobotSettings('r1', 1)
#: Noise of one increment of 0.1 s [m, m, rad], and the covariance of its twist.
SIGMA = np.array([0.01, 0.01, 0.003])
TWIST_COVARIANCE = np.diag(SIGMA ** 2) / 0.1 ** 2
MISSED = 100


def moved(steps):
    """Return the poses (..., 3) after increments (..., K, 3) in the robot's frame."""
    before = np.cumsum(steps[..., 2], axis=-1) - steps[..., 2]
    c, s = np.cos(before), np.sin(before)
    return np.stack([
        np.sum(c * steps[..., 0] - s * steps[..., 1], axis=-1),
        np.sum(s * steps[..., 0] + c * steps[..., 1], axis=-1),
        np.sum(steps[..., 2], axis=-1)], axis=-1)


def heard_after(steps, noise=TWIST_COVARIANCE, robot=ROBOT):
    """Return the missed motion of a robot heard 0.1 s before and after the end of its steps."""
    first = odometry('r1', 0, moved(steps), noise)
    second = odometry('r1', 100, compose(first.pose, steps[-1]), noise)
    return missed_motion(first, (first, second), MISSED, robot)


def errors_of(steps):
    """Return 4000 errors of the motion, in the base frame at the start."""
    noise = np.random.default_rng(0).normal(0.0, SIGMA, (4000, *steps.shape))
    return moved(steps + noise) - moved(steps)


def test_on_a_straight_path_the_covariance_is_that_of_all_its_increments():
    steps = np.tile([0.1, 0.0, 0.0], (MISSED, 1))

    motion = heard_after(steps)

    np.testing.assert_allclose(motion.u, [10.0, 0.0, 0.0], atol=1e-12)
    # 4000 samples give variances to 2.2 % (one sigma), and correlations to 0.016.
    sample = np.cov(errors_of(steps).T)
    sigma = np.sqrt(sample.diagonal())
    np.testing.assert_allclose(
        motion.Q / np.outer(sigma, sigma), sample / np.outer(sigma, sigma), atol=0.08)


@pytest.mark.parametrize('turn', [0.02, 0.0628, -0.1])
def test_on_a_winding_path_the_covariance_is_not_too_small(turn):
    steps = np.tile([0.1, 0.0, turn], (MISSED, 1))

    motion = heard_after(steps)

    # Errors weighted by Q have the mean 3 if Q is right, less if it is larger; the mean of 4000
    # has a standard deviation of 0.04.
    e = errors_of(steps)
    nees = np.einsum('ni,ij,nj->n', e, np.linalg.inv(motion.Q), e)
    assert nees.mean() < 3.1


def test_odometry_without_covariance_has_the_noise_of_its_robot():
    robot = RobotSettings(
        'r1', 1, odometry_sigma=(0.02, 0.02, 0.01), odometry_noise_scale=2.0)

    motion = heard_after(np.tile([0.1, 0.0, 0.0], (MISSED, 1)), None, robot=robot)

    # 10 s at 0.01 rad per square root of a second, scaled by 2.
    assert motion.Q[2, 2] == pytest.approx(4.0 * 10.0 * 0.01 ** 2, rel=1e-9)


@pytest.mark.parametrize(('first', 'missed', 'reason'), [
    ((5.0, 0.0, 0.0), 3, 'after 3 messages: too far from its origin for 0.3 s'),
    ((0.2, 0.0, 2.0), 3, 'after 3 messages: too far from its origin for 0.3 s'),
    ((5.0, 0.0, 0.0), 4900, 'its heading has a standard deviation of 0.21 rad'),
    ((5.0, 0.0, 0.0), None, 'it is unknown how long it had moved')])
def test_a_motion_that_cannot_be_known_has_a_reason(first, missed, reason):
    begin = odometry('r1', 0, first, TWIST_COVARIANCE)
    end = odometry('r1', 100, compose(begin.pose, np.array([0.1, 0.0, 0.0])), TWIST_COVARIANCE)

    found = missed_motion(begin, (begin, end), missed, ROBOT)

    assert reason in found
    assert 'first odometry received is' in found


@pytest.mark.parametrize(('speed', 'distance', 'is_known'), [
    # In 2 s: at three times the speed of the increment, or at 1 m/s.
    (1.0, 5.9, True), (1.0, 6.1, False), (0.1, 1.9, True), (0.1, 2.1, False)])
def test_the_motion_is_known_if_its_speed_is_plausible(speed, distance, is_known):
    first, second = (
        odometry('r1', ms, (distance + ms / 1000 * speed, 0.0, 0.0), TWIST_COVARIANCE)
        for ms in (0, 100))

    found = missed_motion(first, (first, second), 20, ROBOT)

    assert isinstance(found, Motion) == is_known


def test_the_motion_leads_from_the_origin_to_the_first_odometry():
    steps = np.tile([0.1, 0.02, 0.01], (MISSED, 1))

    motion = heard_after(steps)

    np.testing.assert_allclose(motion.u, moved(steps), atol=1e-12)


def test_the_motion_has_no_systematic_errors_of_odometry():
    steps = np.tile([0.1, 0.0, 0.0], (MISSED, 1))
    robot = replace(ROBOT, odometry_scale=(0.8, 1.0), odometry_turn_bias=-0.01)

    motion = heard_after(steps, robot=robot)

    # 0.1 s for each of the missed messages.
    np.testing.assert_allclose(motion.u, [0.08 * MISSED, 0.0, 0.001 * MISSED], atol=1e-12)
