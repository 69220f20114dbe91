# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator node has the documented interface to other nodes."""

import math
import signal
from time import monotonic

import numpy as np
import pytest
from rosbags.typesys.stores import ros2_jazzy as ros

from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.parameters import parse
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.topic_types import JOINT_COVARIANCE_TOPIC
from helpers.optional import optional
from helpers.records import MS, odometry, scan
from helpers.ros import (
    cloud, drive as drive_all, meeting, ODOMETRY, odometry_message, raw, raw_record, seen,
    write_parameters)

live_helpers = optional('helpers.live')
services = optional('rcl_interfaces.srv')
Parameter = optional('rclpy.parameter').Parameter

pytestmark = pytest.mark.ros

TEAM = {'robots': ['r1', 'r2']}
CLOUD = 'sensor_msgs/msg/PointCloud2'
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
JOINT = 'std_msgs/msg/Float64MultiArray'

#: Rows and columns of x, y, yaw in a covariance of x, y, z, rX, rY, rZ.
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])


def stamps(poses):
    """Return the stamps of poses in ms."""
    return [p.header.stamp.sec * 1000 + p.header.stamp.nanosec // MS for p in poses]


def drive(*robots, end=400):
    """Return the odometry of robots that drive straight ahead, every 200 ms."""
    return [raw_record(odometry(robot, ms)) for ms in range(0, end + 1, 200) for robot in robots]


def values(status):
    """Return the values of a diagnostic status by key."""
    return {item.key: item.value for item in status.values}


def newest(reports, robot):
    """Return what the newest report says of a robot, its sentence as 'message'."""
    statuses = {status.name: status for report in reports[-1:] for status in report.status}
    status = statuses[f'estimator: {robot}']
    return {'message': status.message, **values(status)}


@pytest.mark.parametrize(
    ('topic', 'type_name', 'durability'),
    [
        ('/r1/pose', live_helpers.POSE, 'VOLATILE'),
        ('/r2/path', 'nav_msgs/msg/Path', 'VOLATILE'),
        ('/r2/map_landmarks', CLOUD, 'TRANSIENT_LOCAL'),
        ('/estimator/landmarks', CLOUD, 'TRANSIENT_LOCAL'),
        ('/estimator/markers', 'visualization_msgs/msg/MarkerArray', 'VOLATILE'),
        ('/estimator/joint_covariance', JOINT, 'VOLATILE'),
        ('/estimator/rejections', STATUS, 'VOLATILE'),
        ('/diagnostics', live_helpers.DIAGNOSTICS, 'VOLATILE'),
    ],
)
def test_an_output_is_reliable_and_of_its_type(domain, topic, type_name, durability):
    domain.estimate(**TEAM)

    domain.until(lambda: domain.node.get_publishers_info_by_topic(topic))

    publisher, = domain.node.get_publishers_info_by_topic(topic)
    assert publisher.topic_type == type_name
    assert publisher.qos_profile.reliability.name == 'RELIABLE'
    assert publisher.qos_profile.durability.name == durability


@pytest.mark.parametrize(
    ('topic', 'type_name'),
    [
        ('/r1/odom', ODOMETRY), ('/r2/landmarks', CLOUD), ('/r1/ground_truth', ODOMETRY),
        ('/ground_truth/landmarks', CLOUD),
    ],
)
def test_an_input_is_of_its_type(domain, topic, type_name):
    domain.estimate(**TEAM)

    domain.until(lambda: domain.node.get_subscriptions_info_by_topic(topic))

    subscriptions = domain.node.get_subscriptions_info_by_topic(topic)
    assert {subscription.topic_type for subscription in subscriptions} == {type_name}


@pytest.mark.parametrize(
    ('given', 'reliability', 'depth'),
    [({}, 'BEST_EFFORT', 200), ({'reliability': 'reliable', 'depth': 7}, 'RELIABLE', 7)],
)
def test_an_input_is_best_effort_and_200_deep_unless_overridden(domain, given, reliability, depth):
    overrides = {f'qos_overrides./r1/odom.subscription.{key}': given[key] for key in given}
    node = domain.estimate(**TEAM, **overrides)

    domain.until(lambda: domain.node.get_subscriptions_info_by_topic('/r1/odom'))

    subscription, = (
        endpoint for endpoint in domain.node.get_subscriptions_info_by_topic('/r1/odom')
        if endpoint.node_name == 'estimator')
    assert subscription.qos_profile.reliability.name == reliability
    # DDS does not tell others how deep a queue is.
    override = 'qos_overrides./r1/odom.subscription'
    assert node.get_parameter(f'{override}.depth').value == depth
    assert node.get_parameter(f'{override}.history').value == 'keep_last'


def test_an_output_is_as_overridden(domain):
    override = 'qos_overrides./estimator/landmarks.publisher'
    domain.estimate(
        **TEAM, **{f'{override}.reliability': 'best_effort', f'{override}.durability': 'volatile'})

    domain.until(lambda: domain.node.get_publishers_info_by_topic('/estimator/landmarks'))

    publisher, = domain.node.get_publishers_info_by_topic('/estimator/landmarks')
    assert publisher.qos_profile.reliability.name == 'BEST_EFFORT'
    assert publisher.qos_profile.durability.name == 'VOLATILE'


def test_a_renamed_parameter_is_declared_under_its_new_name(domain):
    node = domain.estimate(**TEAM, second_look=True)

    assert node.get_parameter('inflate_rejected_scans').value is True
    assert not node.has_parameter('second_look')


def test_an_integer_for_a_number_becomes_one(domain):
    node = domain.estimate(**TEAM, max_delay=1, anchor_pose=[1, 2, 0])

    assert node.get_parameter('max_delay').value == 1.0
    assert list(node.get_parameter('anchor_pose').value) == [1.0, 2.0, 0.0]


@pytest.mark.parametrize(
    ('name', 'low', 'high', 'words'),
    [
        ('max_delay', 0.0, 1e9, ''),
        ('gate_probability', 0.0, 1.0, 'a number above 0 and up to 1'),
        ('join_min_landmarks', 2, 1000, ''),
        ('update_iterations', 0, 100, ''),
        ('r2.id', 0, 2147483647, ''),
        ('anchor_pose', -1e9, 1e9, 'three numbers [x, y, yaw] from -1e9 to 1e9'),
        ('filter', None, None, "one of 'fej', 'invariant', 'standard', 'ideal'"),
    ],
)
def test_a_parameter_descriptor_has_meaning_and_range(domain, name, low, high, words):
    domain.estimate(**TEAM)

    descriptor, = domain.ask(
        '/estimator/describe_parameters', services.DescribeParameters, names=[name]).descriptors

    ranges = *descriptor.floating_point_range, *descriptor.integer_range
    assert [(r.from_value, r.to_value) for r in ranges] == [(low, high)] * (low is not None)
    assert descriptor.additional_constraints == words
    assert descriptor.description == str(parameters.known_parameters(TEAM['robots'])[name])


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('filter', 'standard'), ('max_dely', 0.2),
        ('qos_overrides./r1/odom.subscription.depth', 7),
        ('qos_overrides./r1/pose.publisher.depth', 8),
    ],
)
def test_what_is_read_at_the_start_does_not_change_and_nothing_is_added(domain, name, value):
    override = {'qos_overrides./r1/odom.subscription.depth': 5}
    node = domain.estimate(**TEAM, **override)
    before = node.get_parameters_by_prefix('')
    changed = Parameter(name, value=value).to_parameter_msg()

    result, = domain.ask(
        '/estimator/set_parameters', services.SetParameters, parameters=[changed]).results

    assert not result.successful
    assert result.reason
    assert node.get_parameters_by_prefix('').keys() == before.keys()
    assert all(node.get_parameter(key).value == p.value for key, p in before.items())


def test_an_override_for_an_unknown_topic_is_a_warning(domain, capfd):
    domain.estimate(**TEAM, **{'qos_overrides./r1/odm.subscription.depth': 5})

    assert "'qos_overrides./r1/odm.subscription.depth' has no effect" in capfd.readouterr().err


def test_each_step_gives_a_pose_and_its_part_of_the_joint_covariance(domain):
    domain.estimate(**TEAM)
    poses = {name: domain.listen(f'{name}/pose', live_helpers.POSE) for name in TEAM['robots']}
    joint = domain.listen('/estimator/joint_covariance', JOINT)

    domain.send(*map(raw_record, meeting(6)))
    domain.until(lambda: len(joint) == 4)

    assert stamps(poses['r1']) == stamps(poses['r2']) == [0, 100, 200, 300]
    # r2 is alone until both see landmarks.
    assert [pose.header.frame_id for pose in poses['r2']] == ['r2/map', 'map', 'map', 'map']
    assert joint[0].layout.dim[0].label == 'r1@0'
    assert joint[3].layout.dim[0].label == f'r1@{300 * MS},r2@{300 * MS}'
    blocks = joint[3].data.reshape(2, 3, 2, 3)
    for k, name in enumerate(TEAM['robots']):
        alone = poses[name][3].pose.covariance.reshape(6, 6)[PLANAR]
        np.testing.assert_array_equal(blocks[k, :, k], alone)


def test_a_robot_that_shares_no_landmark_stays_in_its_own_map(domain):
    domain.estimate(**TEAM)
    poses = domain.listen('r2/pose', live_helpers.POSE)
    own = domain.listen('r2/map_landmarks', CLOUD)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)

    observations = scan('r1', 0, [(1, (5.0, 1.0))]), scan('r2', 0, [(7, (3.0, 0.0))])
    domain.send(*map(raw_record, observations), *drive('r1', 'r2'))
    domain.until(lambda: poses and own and reports)
    domain.until(lambda: 'shared' in newest(reports, 'r2')['message'])

    assert poses[0].header.frame_id == own[0].header.frame_id == 'r2/map'
    assert newest(reports, 'r2')['message'].startswith('r2 not joined: 0 shared landmarks')


def test_after_a_stall_all_messages_are_added_before_the_next_step(domain):
    node = domain.estimate(**TEAM)
    messages = [*map(raw_record, meeting(40))]
    # These go to all four topics.
    domain.send(*messages[:6])
    domain.until(lambda: node.received == 6)

    domain.send(*messages[6:])
    live_helpers.serve(node, node.executor)

    assert node.received == len(messages)


def test_the_last_steps_are_published_when_the_input_pauses(domain):
    domain.estimate(**TEAM, stale_after=0.5)
    poses = domain.listen('r1/pose', live_helpers.POSE)

    began = monotonic()
    domain.send(*drive('r1', 'r2'))
    domain.until(lambda: stamps(poses) == [0, 200, 400])

    assert monotonic() - began >= 0.5


def tick(domain, node, ms):
    """Set the clock of a node."""
    domain.send(raw('clock', ros.rosgraph_msgs__msg__Clock(
        ros.builtin_interfaces__msg__Time(sec=ms // 1000, nanosec=ms % 1000 * MS))))
    domain.until(lambda: node.get_clock().now().nanoseconds == ms * MS)


def test_a_pause_is_measured_in_simulated_time(domain):
    node = domain.estimate(**TEAM, use_sim_time=True, stale_after=1.0)
    poses = domain.listen('r1/pose', live_helpers.POSE)

    tick(domain, node, 400)
    domain.send(*drive('r1', 'r2'))
    domain.until(lambda: stamps(poses) == [0, 200])
    tick(domain, node, 1399)
    assert stamps(poses) == [0, 200]
    tick(domain, node, 1401)
    domain.until(lambda: stamps(poses) == [0, 200, 400])


def test_a_clock_that_goes_back_releases_the_last_steps(domain):
    node = domain.estimate(**TEAM, use_sim_time=True, stale_after=1.0)
    poses = domain.listen('r1/pose', live_helpers.POSE)

    tick(domain, node, 400)
    domain.send(*drive('r1', 'r2'))
    domain.until(lambda: stamps(poses) == [0, 200])
    tick(domain, node, 100)

    domain.until(lambda: stamps(poses) == [0, 200, 400])


NAN = cloud({'x': ('f8', [math.nan]), 'y': ('f8', [1.0]), 'id': ('i4', [3])})


@pytest.mark.parametrize(
    ('message', 'reason', 'number'),
    [
        (seen((3, 1.0, 1.0), frame='camera'), 'wrong_frame', None),
        (cloud({'x': ('f8', [1.0])}), 'bad_cloud', None),
        (NAN, 'not_finite', '3'),
    ],
)
def test_rejections_are_published_and_counted(domain, message, reason, number):
    domain.estimate(**TEAM)
    rejections = domain.listen('/estimator/rejections', STATUS)
    reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)

    domain.send(*drive('r1', end=0))
    domain.send(raw('r1/landmarks', message))
    domain.until(lambda: rejections and reports and reason in newest(reports, 'r1'))

    rejection = values(rejections[0])
    assert (rejection['robot'], rejection['reason'], rejection.get('id')) == ('r1', reason, number)
    assert newest(reports, 'r1')[reason] == '1'
    assert reason not in newest(reports, 'r2')


def test_a_message_from_the_future_is_rejected(domain):
    domain.estimate(**TEAM)
    rejections = domain.listen('/estimator/rejections', STATUS)

    in_a_minute = odometry_message(domain.node.get_clock().now().nanoseconds / MS + 60_000)
    domain.send(raw('r1/odom', in_a_minute))
    domain.until(lambda: rejections)

    assert values(rejections[0])['reason'] == 'future'


def test_reset_starts_new_estimates_and_files(domain, tmp_path):
    domain.estimate(**TEAM, output=str(tmp_path / 'run'))
    (tmp_path / 'run_2').mkdir()
    poses = domain.record('r1/pose', live_helpers.POSE)
    joint = domain.listen('/estimator/joint_covariance', JOINT)

    domain.send(*map(raw_record, meeting(20)))
    domain.until(lambda: len(joint) == 18)
    first = poses[:4]
    assert domain.call('/estimator/reset')
    domain.send(*map(raw_record, meeting(6)))
    domain.until(lambda: len(joint) == 24)
    domain.end_estimate()

    # The reset finished the two steps that still waited.
    assert poses[20:24] == first
    # The files of an earlier reset stay as they are.
    assert not list((tmp_path / 'run_2').iterdir())
    for folder, steps in ('run', 20), ('run_3', 6):
        rows = (tmp_path / folder / 'trajectory_r1.csv').read_text().splitlines()[1:]
        stamps = [row.partition(',')[0] for row in rows]
        assert stamps == [str(ms * MS) for ms in range(0, 100 * steps, 100)]


def test_a_saved_run_continues_where_it_was_saved(domain, tmp_path):
    path = tmp_path / 'run.checkpoint'
    node = domain.estimate(**TEAM, checkpoint=str(path))
    joint = domain.listen('/estimator/joint_covariance', JOINT)
    messages = [*map(raw_record, meeting(20))]
    domain.send(*messages[:40])
    domain.until(lambda: node.received == 40)

    assert domain.call('/estimator/save')
    domain.send(*messages[40:])
    domain.until(lambda: len(joint) == 18)
    domain.end_estimate()
    domain.until(lambda: len(joint) == 20)

    restored = EstimatorSession(parse({**TEAM, 'restore': str(path)}), None)
    published = drive_all(restored, messages[40:])
    rest = [message for topic, message in published if topic == JOINT_COVARIANCE_TOPIC]
    np.testing.assert_array_equal(rest[-1].data, joint[-1].data)
    assert 0 < len(rest) < 20


def test_without_a_checkpoint_parameter_save_fails(domain):
    domain.estimate(**TEAM)

    assert not domain.call('/estimator/save')


@pytest.mark.slow
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_node_with_last_steps_and_complete_files(
    domain, tmp_path, number,
):
    # What best effort loses before both processes know each other would be missed here.
    given = write_parameters(
        tmp_path / 'team.yaml', **TEAM, output=str(tmp_path / 'results'), stale_after=60.0,
        **live_helpers.reliable_inputs(TEAM['robots']))
    estimator = domain.start('estimator', '--ros-args', '--params-file', given)
    poses = domain.listen('r1/pose', live_helpers.POSE)
    domain.wait_for_reports()
    domain.send(*map(raw_record, meeting(6)))
    domain.until(lambda: len(poses) == 4)
    status, errors = domain.finish(estimator, number)

    assert status == 0, errors
    names = {path.name for path in (tmp_path / 'results').iterdir()}
    assert names == {
        'landmarks.csv', 'r1.tum', 'r2.tum', 'summary.json', 'trajectory_r1.csv',
        'trajectory_r2.csv'}
    rows = (tmp_path / 'results' / 'trajectory_r1.csv').read_text().splitlines()[1:]
    assert len(rows) == 6
