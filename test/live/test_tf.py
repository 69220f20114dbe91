# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms are published where tf2_msgs is installed; elsewhere the node works without."""

import sys

import numpy as np
import pytest
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Quaternion as Quaternion, geometry_msgs__msg__Transform as Transform,
    geometry_msgs__msg__TransformStamped as TransformStamped,
    geometry_msgs__msg__Vector3 as Vector3, tf2_msgs__msg__TFMessage as TFMessage)
from scipy.spatial.transform import Rotation

from fej_slam_ros.core.records import NS, Odometry, Scan
from fej_slam_ros.ros.messages.own_results import map_landmarks
from fej_slam_ros.ros.session import simulation
from helpers.message_packages import provided
from helpers.optional import optional
from helpers.records import MS, odometry
from helpers.ros import CLOUD, header, meeting, raw, raw_record, seen, write_parameters

live_helpers = optional('helpers.live')
endpoints = optional('fej_slam_ros.ros.nodes.endpoints')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = pytest.mark.ros

TEAM = {'robots': ['r1', 'r2']}
TF = 'tf2_msgs/msg/TFMessage'


@pytest.fixture(scope='module')
def tf2_msgs(tmp_path_factory):
    """Provide tf2_msgs to this process and its children."""
    definitions = {'TFMessage': 'geometry_msgs/TransformStamped[] transforms\n'}
    with provided(tmp_path_factory.mktemp('tf2'), {'tf2_msgs': definitions}):
        yield


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


@pytest.mark.slow
@pytest.mark.usefixtures('tf2_msgs')
def test_map_to_odom_composed_with_odometry_is_the_predicted_pose(domain, tmp_path):
    records = [
        record for record in simulation.parse({'loops': 1, 'steps_per_loop': 25}).records()
        if isinstance(record, (Odometry, Scan))]
    by_odometry = {(r.robot, r.stamp): r.pose for r in records if isinstance(r, Odometry)}
    reliable = live_helpers.reliable_inputs(TEAM['robots'])
    parameters = write_parameters(
        tmp_path / 'team.yaml', **TEAM, **reliable, transform_tolerance=0.25, tf_topics='both')
    domain.start('estimator', '--ros-args', '--params-file', parameters)
    messages = domain.listen('/tf', TF)
    of_robots = [domain.listen(f'/{robot}/tf', TF) for robot in TEAM['robots']]
    poses = {
        name: domain.listen(f'{name}/predicted_pose', live_helpers.POSE)
        for name in TEAM['robots']}
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
    # DDS discovers endpoints in order: when a report arrives, the poses are connected.
    domain.until(lambda: reports and domain.node.count_publishers('/tf'))

    # Odometry that arrives together with the first step is predicted once, later odometry at once.
    first = [raw_record(record) for record in records if record.stamp < 3 * NS]
    domain.send(*first)
    domain.until(lambda: all(poses.values()))
    domain.send(*map(raw_record, records[len(first):]))
    newest = max(stamp for _, stamp in by_odometry)
    domain.until(lambda: all(p and stamp_of(p[-1]) == newest for p in poses.values()))
    domain.until(lambda: len(messages) == sum(map(len, poses.values())))
    domain.until(lambda: (
        [len(robot_poses) for robot_poses in of_robots] == [len(p) for p in poses.values()]))

    later = {key for key in by_odometry if key[1] >= 3 * NS}
    assert len(messages) >= len(later) > 20
    for transform in (transform for message in messages for transform in message.transforms):
        robot, _, frame = transform.child_frame_id.partition('/')
        stamp = stamp_of(transform) - 250 * MS
        pose = next(p for p in poses[robot] if stamp_of(p) == stamp)
        assert (frame, transform.header.frame_id) == ('odom', pose.header.frame_id)
        x, y, phi = by_odometry[robot, stamp]
        t, q = transform.transform.translation, transform.transform.rotation
        turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
        at = turn.apply([x, y, 0.0]) + np.array([t.x, t.y, t.z])
        # Coordinates are about 100 m: rounding errors.
        p = pose.pose.pose.position
        np.testing.assert_allclose(at, [p.x, p.y, p.z], atol=1e-11)
        q = pose.pose.pose.orientation
        turned = turn * Rotation.from_euler('z', phi)
        whole = Rotation.from_quat([q.x, q.y, q.z, q.w])
        assert (turned.inv() * whole).magnitude() < 1e-12


@pytest.mark.slow
@pytest.mark.usefixtures('tf2_msgs')
def test_the_smoother_publishes_a_transform_with_each_pose_if_asked_to(domain, tmp_path):
    parameters = write_parameters(
        tmp_path / 'team.yaml', **TEAM, publish_smoothed_tf=True,
        **live_helpers.reliable_inputs(TEAM['robots']))
    domain.start('smoother', '--ros-args', '--params-file', parameters)
    messages = domain.listen('/tf', TF)
    poses = [domain.listen(f'{name}/pose', live_helpers.POSE) for name in TEAM['robots']]
    domain.until(lambda: domain.node.count_publishers('/tf'))

    domain.send(*map(raw_record, meeting(6)))
    domain.until(lambda: all(len(robot_poses) >= 4 for robot_poses in poses))
    domain.until(lambda: len(messages) == sum(map(len, poses)))

    found = {
        (stamp_of(transform) - 100 * MS, transform.child_frame_id)
        for message in messages for transform in message.transforms}
    assert found == {
        (stamp_of(pose), f'{name}/odom')
        for name, robot_poses in zip(TEAM['robots'], poses) for pose in robot_poses}


def test_without_tf2_msgs_the_node_warns_once_and_works(domain, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)
    domain.estimate(**TEAM)
    poses = domain.listen('r2/pose', live_helpers.POSE)

    domain.send(*map(raw_record, meeting(6)))
    domain.until(lambda: len(poses) == 4)
    assert domain.call('/estimator/reset')

    assert capfd.readouterr().err.count('because tf2_msgs is missing: install ') == 1


def test_publish_tf_false_needs_no_tf2_msgs(domain, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, 'tf2_msgs', None)

    domain.estimate(**TEAM, publish_tf=False)

    assert 'tf2_msgs' not in capfd.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures('tf2_msgs')
def test_sensor_mounts_come_from_static_transforms(domain):
    node = domain.estimate(robots=['r1'], max_delay=0.0, map_period=0.05)
    mount = TransformStamped(
        header=header(0, 'r1/base_link'), child_frame_id='r1/laser',
        transform=Transform(
            translation=Vector3(x=0.5, y=0.0, z=1.0),
            # A quarter turn to the left.
            rotation=Quaternion(x=0.0, y=0.0, z=np.sqrt(0.5), w=np.sqrt(0.5))))
    publisher = domain.node.create_publisher(
        endpoints.message_class(TF), '/tf_static', qos.reliable(1, latched=True))
    # Sent before the nodes have discovered each other: the publisher keeps it.
    publisher.publish(raw('tf_static', TFMessage(transforms=[mount])).raw)
    maps = domain.listen('/estimator/landmarks', CLOUD)
    domain.until(lambda: node.received == 1)

    laser = raw('r1/landmarks', seen((1, 2.0, 0.0), frame='r1/laser'))
    domain.send(raw_record(odometry('r1', 0)), laser)
    domain.send(*(raw_record(odometry('r1', ms)) for ms in (100, 200)))
    domain.until(lambda: maps)

    (found,) = map_landmarks(maps[0])[1]
    # 0.5 m ahead and 2 m to the left.
    np.testing.assert_allclose(found, [0.5, 2.0], atol=1e-12)
