# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A bag without landmarks has other topics from which they are computed."""

import pytest

from fej_slam_ros.ros.files.bags import BagTopic
from fej_slam_ros.ros.files.front_end_topics import cure

SCAN = BagTopic('sensor_msgs/msg/LaserScan', 100, latched=False)
ODOMETRY = BagTopic('nav_msgs/msg/Odometry', 100, latched=False)


@pytest.mark.parametrize(('topics', 'named'), [
    ({'r1/odom': ODOMETRY, 'r1/scan': SCAN}, 'in r1/scan: fej_slam detect BAG'),
    # A single robot often has no namespace.
    ({'odom': ODOMETRY, 'scan': SCAN}, '--remap /scan:=/r1/scan'),
    ({'r1/odom': ODOMETRY, 'base/front': SCAN}, '--remap /base/front:=/r1/scan'),
])
def test_a_scan_that_may_be_of_the_robot_is_named(topics, named):
    assert named in cure(topics, 'r1')


@pytest.mark.parametrize('topics', [
    {'r1/odom': ODOMETRY, 'r2/odom': ODOMETRY, 'r2/scan': SCAN},
    {'r1/odom': ODOMETRY, 'front': SCAN, 'rear': SCAN},
    {'odom': ODOMETRY, 'scan': BagTopic(SCAN.type_name, 0, latched=False)},
])
def test_no_scan_is_named_that_is_of_another_robot_or_one_of_several_or_empty(topics):
    assert cure(topics, 'r1') == ''
