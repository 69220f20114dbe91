# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An estimator that starts after its robots over DDS: start poses hold where robots started."""

import numpy as np
import pytest

from helpers.optional import optional
from helpers.ros import cdr, odometry_message

live = optional('helpers.live')
nav_msgs = optional('nav_msgs.msg')
rclpy = optional('rclpy')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = pytest.mark.ros

TEAM = {
    'robots': ['r1', 'r2'], 'r2.start_pose': [5.0, 1.0, 0.0], 'stale_after': 60.0,
    'max_delay': 0.0}


@pytest.fixture
def context(domain):  # noqa: ARG001
    """Return a ROS context of the robots, which are there before the estimator."""
    context = rclpy.Context()
    context.init()
    yield context
    context.try_shutdown()


class Robots:
    """Robots that drive straight ahead at 1 m/s and send odometry at 10 Hz."""

    def __init__(self, domain, context, begin=0.0):
        self._node = rclpy.create_node('robots', context=context, use_global_arguments=False)
        self._publishers = {
            robot: self._node.create_publisher(
                nav_msgs.Odometry, f'{robot}/odom', qos.reliable(1000))
            for robot in TEAM['robots']}
        self._domain = domain
        self._begin = begin
        self._sent = 0

    def send(self, count):
        """Send odometry, whether somebody listens or not."""
        for _ in range(count):
            message = odometry_message(
                100 * self._sent, (self._begin + 0.1 * self._sent, 0.0, 0.0),
                twist_covariance=0.01 * np.eye(6))
            for publisher in self._publishers.values():
                publisher.publish(cdr(message))
            self._sent += 1

    def wait_for_estimator(self):
        """Wait until both subscriptions of the estimator know the odometry, and it knows them."""
        self._domain.until(lambda: all(
            publisher.get_subscription_count() == 2
            and self._domain.has_publisher(f'/{robot}/odom')
            for robot, publisher in self._publishers.items()))


def newest_pose(domain, robots):
    """Return the newest of four poses of r2; the first ones may be sent before we listen."""
    poses = domain.listen('r2/pose', live.POSE)
    robots.wait_for_estimator()
    domain.until(lambda: robots.send(1) or len(poses) >= 4)
    return poses[-1]


def assert_ahead(pose):
    """Check that r2 is as far ahead of [5, 1] as its odometry has counted; return the count."""
    sent = round((pose.header.stamp.sec + 1e-9 * pose.header.stamp.nanosec) / 0.1)
    assert pose.header.frame_id == 'map'
    assert pose.pose.pose.position.x == pytest.approx(5.0 + 0.1 * sent, abs=1e-9)
    return sent


@pytest.mark.parametrize('missed', [1, 100])
def test_a_moving_robot_that_is_heard_late_is_where_its_odometry_says(domain, context, missed):
    robots = Robots(domain, context)
    robots.send(missed)
    domain.estimate(**TEAM)

    pose = newest_pose(domain, robots)

    sent = assert_ahead(pose)
    assert pose.pose.pose.position.y == pytest.approx(1.0, abs=1e-9)
    # Each of the increments has a variance of 0.01 m^2/s^2 times (0.1 s)^2, with errors of the
    # heading on top.
    assert pose.pose.covariance[0] == pytest.approx(1e-4 * sent, rel=1e-6)
    assert pose.pose.covariance[7] > 1e-4 * sent


def test_odometry_may_begin_anywhere_if_its_first_message_is_heard(domain, context):
    robots = Robots(domain, context, begin=70.0)
    domain.estimate(**TEAM)

    pose = newest_pose(domain, robots)

    assert_ahead(pose)


def test_a_robot_whose_motion_is_unknown_is_not_in_map_and_says_why(domain, context):
    robots = Robots(domain, context, begin=70.0)
    robots.send(3)
    domain.estimate(**TEAM)

    pose = newest_pose(domain, robots)

    assert pose.header.frame_id == 'r2/map'
    reports = domain.listen('/diagnostics', live.DIAGNOSTICS)
    domain.until(lambda: any(
        'too far from its origin' in status.message
        for report in reports for status in report.status))


@pytest.mark.slow
def test_a_smoother_that_hears_a_moving_anchor_late_warns_where_map_begins(domain, context):
    robots = Robots(domain, context)
    robots.send(100)
    log = domain.listen('/rosout', 'rcl_interfaces/msg/Log')
    domain.start(
        'smoother', '--ros-args', '-p', 'robots:=[r1, r2]', '-p', 'anchor_pose:=[1.0, 0.0, 0.0]')

    # The line is logged once, and lost if DDS connects /rosout after the odometry.
    domain.until(lambda: any('waiting for odometry' in line.msg for line in log))
    domain.until(lambda: robots.send(1) or any(
        'map begins at the first odometry received of r1' in line.msg for line in log))
