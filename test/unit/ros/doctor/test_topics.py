# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Missing topics are reported with cures that the bag allows."""

import pytest

from fej_slam_ros.ros.doctor import topics
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.recorded_robots import RecordedRobots
from fej_slam_ros.ros.files.topic_names import RECORDED_NAMES
from helpers.ros import odometry_message, raw, seen, write_bag

ODOMETRY, OBSERVATION = odometry_message(), seen((1, 2.0, 3.0))


@pytest.fixture
def cures(tmp_path):
    """Return a function that returns the cure of each finding, by name, for messages by topic."""
    def examine(messages, **others):
        path = write_bag(tmp_path / 'bag', [raw(topic, m, 0) for topic, m in messages.items()])
        found = topics.check(
            bags.topics(path) | others, ['r1'], '', RecordedRobots(path, RECORDED_NAMES, ['r1']))
        return {finding.name: finding.cure for finding in found}
    return examine


@pytest.mark.parametrize('messages', [
    {'r1/odom': ODOMETRY, 'r1/posts': OBSERVATION},
    {'r1/wheel/odometry': ODOMETRY, 'r1/posts': OBSERVATION}])
def test_landmarks_on_a_topic_of_another_name_are_remapped(cures, messages):
    cure = cures(messages)['no_landmarks']

    assert '--remap /r1/posts:=/r1/landmarks' in cure
    assert 'AprilTags' not in cure


@pytest.mark.parametrize(('topic', 'type_name', 'cure'), [
    ('imu', 'sensor_msgs/msg/Imu', ''),
    ('tf', 'tf2_msgs/msg/TFMessage', 'fej_slam adapt computes it from the transforms on /tf'),
    ('detections', 'apriltag_msgs/msg/AprilTagDetectionArray', 'for the AprilTags record /tf')])
def test_tags_are_a_cure_only_where_a_bag_may_have_some(cures, topic, type_name, cure):
    other = {topic: bags.BagTopic(type_name, 5, latched=False)}

    found = cures({'r1/odom': ODOMETRY}, **other)['no_landmarks']

    assert found.startswith('record sensor_msgs/PointCloud2 on r1/landmarks')
    assert cure in found
    assert ('AprilTags' in found) == bool(cure)
