# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of the simulator node: velocities of the motion, and stamps from the present on."""

import math

import numpy as np
import pytest

from fej_slam_ros.ros.messages import deserialize, incoming, stamp_of
from fej_slam_ros.ros.session import simulated_input, simulation

#: One loop of 20 m in 40 steps of 0.2 s, without noise worth mentioning.
CIRCLE = {
    'robots': ['r1'], 'loops': 1, 'steps_per_loop': 40, 'loop_lengths': [20.0, 20.0],
    'odometry_sigma': [1e-9] * 3, 'landmarks': 6}
NOW = 1_700_000_000_123_456_789


def odometry(now=None, **values):
    messages = simulated_input.messages(simulation.parse({**CIRCLE, **values}), now)
    return [deserialize(m.raw, m.type_name) for m in messages if m.topic == 'r1/odom']


@pytest.mark.parametrize(('now', 'speed', 'factor'), [
    (None, 1.0, 1.0), (None, 4.0, 1.0), (lambda: NOW, 1.0, 1.0), (lambda: NOW, 4.0, 4.0)])
def test_odometry_has_the_velocity_of_the_motion(now, speed, factor):
    first, *moving = odometry(now, speed=speed)

    assert first.twist.twist.linear.x == 0.0
    for message in moving:
        velocity = message.twist.twist
        # 20 m and a full turn in 8 s, against the chord of a step.
        assert velocity.linear.x == pytest.approx(factor * 20.0 / 8.0, rel=0.01)
        assert abs(velocity.angular.z) == pytest.approx(factor * math.tau / 8.0, rel=1e-6)
        # Forward in the frame at the beginning of a step is slightly sideways at its end.
        assert abs(velocity.linear.y) < 0.1 * velocity.linear.x


def test_velocities_integrate_to_the_published_poses():
    messages = odometry()

    x = y = yaw = 0.0
    for message in messages[1:]:
        v = message.twist.twist
        x += 0.2 * (v.linear.x * math.cos(yaw) - v.linear.y * math.sin(yaw))
        y += 0.2 * (v.linear.x * math.sin(yaw) + v.linear.y * math.cos(yaw))
        yaw += 0.2 * v.angular.z
        at = message.pose.pose.position
        assert (x, y) == pytest.approx((at.x, at.y), abs=1e-9)


@pytest.mark.parametrize('speed', [0.5, 1.0, 4.0])
def test_stamps_go_on_from_the_present_as_fast_as_the_world(speed):
    simulated = simulation.parse({**CIRCLE, 'speed': speed})

    in_real_time = list(simulated_input.messages(simulated, lambda: NOW))
    in_simulated_time = list(simulated_input.messages(simulated, None))

    assert [m.received for m in in_real_time] == [m.received for m in in_simulated_time]
    for real, simulated_message in zip(in_real_time, in_simulated_time):
        elapsed = stamp_of(simulated_message.raw) - simulation.FIRST_STAMP
        assert stamp_of(real.raw) == NOW + round(elapsed / speed)


@pytest.mark.parametrize('speed', [0.5, 1.0, 4.0])
def test_a_faster_world_has_the_same_increments_with_the_same_covariance(speed):
    values = {'speed': speed, 'odometry_sigma': [0.1, 0.2, 0.3]}
    simulated, real = odometry(None, **values), odometry(lambda: NOW, **values)

    pairs = zip(*([incoming.odometry(m, 'r1') for m in run[1:]] for run in (simulated, real)))
    for a, b in pairs:
        np.testing.assert_array_equal(a.pose, b.pose)
        np.testing.assert_allclose(
            a.twist_covariance * 0.2**2, b.twist_covariance * (0.2 / speed)**2, rtol=1e-12)


def test_the_present_is_asked_for_when_the_first_message_is_published():
    asked = []

    messages = simulated_input.messages(
        simulation.parse(CIRCLE), lambda: asked.append(NOW) or NOW)
    assert not asked
    next(messages)
    next(messages)
    assert asked == [NOW]


def test_ground_truth_carries_no_velocity():
    messages = simulated_input.messages(simulation.parse(CIRCLE), None)

    for message in messages:
        if message.topic == 'r1/ground_truth':
            assert deserialize(message.raw, message.type_name).twist.twist.linear.x == 0.0
