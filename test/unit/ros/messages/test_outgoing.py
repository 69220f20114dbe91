# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records survive the round trip through messages; publications have the documented layout."""

from math import pi

import numpy as np
import pytest

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.records import (
    GpsFix, Observation, Odometry, RobotObservation, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.ros.messages import incoming, incoming_clouds, outgoing
from helpers.optional import given, settings, strategies as st
from helpers.ros import R1, through_cdr

LENGTHS = st.floats(-1e6, 1e6)
POSES = st.tuples(LENGTHS, LENGTHS, st.floats(-pi, pi)).map(np.array)
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
IDS = st.integers(0, 2**31 - 1)


def covariances(size):
    """Return a strategy of positive definite matrices that are symmetric to the bit."""
    numbers = st.floats(-10.0, 10.0)
    factors = st.lists(numbers, min_size=size * size, max_size=size * size)
    return factors.map(np.array).map(lambda a: _covariance(a.reshape(size, size)))


def _covariance(factor):
    P = factor @ factor.T + 0.01 * np.eye(len(factor))
    return np.tril(P) + np.tril(P, -1).T


OBSERVATIONS = st.builds(
    Observation, id=IDS, z=st.tuples(LENGTHS, LENGTHS).map(np.array), R=covariances(2))


def assert_pose(pose, expected):
    np.testing.assert_array_equal(pose[:2], expected[:2])
    # The sine and cosine of half the heading are rounded, which may also cost a turn.
    assert abs(np.remainder(pose[2] - expected[2] + pi, 2.0 * pi) - pi) < 2e-15


@given(STAMPS, POSES, st.none() | covariances(3))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_odometry_survives_the_round_trip_through_a_message(stamp, pose, covariance):
    sent = Odometry('r1', stamp, pose, covariance)

    record = incoming.odometry(through_cdr(outgoing.odometry(sent)), 'r1')

    assert (record.robot, record.stamp) == ('r1', stamp)
    assert_pose(record.pose, pose)
    assert np.array_equal(record.twist_covariance, covariance)


@given(STAMPS, st.lists(OBSERVATIONS, max_size=5, unique_by=lambda s: s.id))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_a_scan_survives_the_round_trip_bit_for_bit(stamp, observations):
    message = through_cdr(outgoing.scan(Scan('r1', stamp, tuple(observations))))

    scan, rejected = incoming_clouds.scan(message, R1)

    assert (scan.robot, scan.stamp, rejected) == ('r1', stamp, [])
    assert [s.id for s in scan.observations] == [s.id for s in observations]
    for got, sent in zip(scan.observations, observations):
        np.testing.assert_array_equal(got.z, sent.z)
        np.testing.assert_array_equal(got.R, sent.R)


ROBOT_OBSERVATIONS = st.builds(
    RobotObservation, observed=st.sampled_from(['r2', 'r3', 'r4']),
    z=st.tuples(LENGTHS, LENGTHS).map(np.array), R=covariances(2))


@given(STAMPS, st.lists(ROBOT_OBSERVATIONS, max_size=3, unique_by=lambda s: s.observed))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_a_robot_scan_survives_the_round_trip_bit_for_bit(stamp, observations):
    ids = {'r2': 7, 'r3': 0, 'r4': 2**31 - 1}
    message = through_cdr(outgoing.robot_scan(RobotScan('r1', stamp, tuple(observations)), ids))

    scan, rejected = incoming_clouds.robot_scan(message, R1, {n: name for name, n in ids.items()})

    assert (scan.robot, scan.stamp, rejected) == ('r1', stamp, [])
    assert [s.observed for s in scan.observations] == [s.observed for s in observations]
    for got, sent in zip(scan.observations, observations):
        np.testing.assert_array_equal(got.z, sent.z)
        np.testing.assert_array_equal(got.R, sent.R)


@given(STAMPS, POSES)
@settings(max_examples=50, deadline=None, derandomize=True)
def test_a_true_pose_survives_the_round_trip(stamp, pose):
    record = incoming.true_pose(through_cdr(outgoing.true_pose(TruePose('r1', stamp, pose))), 'r1')

    assert (record.robot, record.stamp) == ('r1', stamp)
    assert_pose(record.pose, pose)


@given(st.dictionaries(IDS, st.tuples(LENGTHS, LENGTHS).map(np.array), max_size=5))
@settings(max_examples=50, deadline=None, derandomize=True)
def test_the_true_map_survives_the_round_trip_bit_for_bit(positions):
    message = through_cdr(outgoing.true_landmarks(TrueLandmarks(positions, 5)))

    got = incoming_clouds.true_landmarks(message).positions

    assert {n: xy.tolist() for n, xy in got.items()} == {
        n: xy.tolist() for n, xy in positions.items()}


@pytest.mark.parametrize(
    ('record', 'topic', 'frame', 'child'),
    [
        (Odometry('r7', 0, np.zeros(3), None), 'r7/odom', 'r7/odom', 'r7/base_link'),
        (Scan('r7', 0, ()), 'r7/landmarks', 'r7/base_link', None),
        (RobotScan('r7', 0, ()), 'r7/robots', 'r7/base_link', None),
        (TruePose('r7', 0, np.zeros(3)), 'r7/ground_truth', 'map', 'r7/base_link'),
        (GpsFix('r7', 0, np.zeros(2), np.eye(2)), 'r7/gps', 'map', 'r7/gps'),
        (TrueLandmarks({}), 'ground_truth/landmarks', 'map', None),
    ])
def test_every_record_has_a_topic_and_frames(record, topic, frame, child):
    published_on, message = outgoing.input_message(record)

    assert (published_on, message.header.frame_id) == (topic, frame)
    assert getattr(message, 'child_frame_id', None) == child


#: A covariance of x, y, yaw whose entries all differ.
P = np.array([[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]])


def estimate(stamp=1_500_000_000, pose=(1.0, 2.0, pi / 2), frame='map', robot='r1', P=P):
    return PoseEstimate(robot, stamp, frame, np.array(pose), P)


def test_a_pose_is_stamped_and_turned_about_z():
    message = through_cdr(outgoing.pose(estimate(frame='r2/map'), 0.0))

    p, q = message.pose.pose.position, message.pose.pose.orientation
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 500_000_000)
    assert (message.header.frame_id, p.x, p.y, p.z) == ('r2/map', 1.0, 2.0, 0.0)
    np.testing.assert_allclose([q.x, q.y, q.z, q.w], [0, 0, 0.5**0.5, 0.5**0.5], rtol=1e-15)


def test_gps_is_a_position_with_covariance_and_no_heading():
    fix = GpsFix('r1', 1_500_000_000, np.array([3.0, 4.0]), np.array([[2.0, 0.5], [0.5, 1.0]]))

    pose = through_cdr(outgoing.input_message(fix)[1]).pose

    covariance = pose.covariance.reshape(6, 6)
    assert (pose.pose.position.x, pose.pose.position.y) == (3.0, 4.0)
    assert covariance[:2, :2].tolist() == fix.P.tolist()
    assert np.diag(covariance)[2:].min() > 2.0 * pi**2


@pytest.mark.parametrize('unused', [0.0, 1e6])
def test_a_pose_covariance_is_row_major_in_x_y_z_roll_pitch_yaw(unused):
    covariance = through_cdr(outgoing.pose(estimate(), unused)).pose.covariance

    expected = np.zeros(36)
    expected[[0, 1, 5, 6, 7, 11, 30, 31, 35]] = [1.0, 0.1, 0.2, 0.1, 2.0, 0.3, 0.2, 0.3, 3.0]
    expected[[14, 21, 28]] = unused
    np.testing.assert_array_equal(covariance, expected)


def test_the_joint_covariance_is_labelled_with_robots_and_stamps():
    joint = np.arange(36.0).reshape(6, 6)

    message = through_cdr(outgoing.joint_covariance([('r1', 70), ('r2', 50)], joint))

    rows, columns = message.layout.dim
    assert (rows.label, rows.size, rows.stride) == ('r1@70,r2@50', 6, 36)
    assert (columns.size, columns.stride, message.layout.data_offset) == (6, 6, 0)
    np.testing.assert_array_equal(message.data, np.arange(36.0))


def test_the_map_has_points_in_both_precisions_and_covariances_in_double_precision():
    covariance = np.array([[[0.1, 0.2], [0.2, 0.9]], [[0.3, 0.0], [0.0, 0.4]]])

    message = through_cdr(outgoing.landmarks(
        1_000_000_000, 'map', [5, 2**31 - 1], np.array([[0.1, 0.2], [3.0, 4.0]]), covariance))

    layout = np.dtype([
        ('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('id', '<i4'), ('var_x', '<f8'),
        ('cov_xy', '<f8'), ('var_y', '<f8'), ('x_f64', '<f8'), ('y_f64', '<f8')])
    codes = {
        'x': 7, 'y': 7, 'z': 7, 'id': 5, 'var_x': 8, 'cov_xy': 8, 'var_y': 8, 'x_f64': 8,
        'y_f64': 8}
    assert {f.name: f.datatype for f in message.fields} == codes
    assert [f.offset for f in message.fields] == [0, 4, 8, 12, 16, 24, 32, 40, 48]
    points = np.frombuffer(message.data.tobytes(), layout)
    assert points.tolist() == [
        (np.float32(0.1), np.float32(0.2), 0.0, 5, 0.1, 0.2, 0.9, 0.1, 0.2),
        (3.0, 4.0, 0.0, 2**31 - 1, 0.3, 0.0, 0.4, 3.0, 4.0)]


def test_an_empty_map_is_an_empty_cloud():
    message = through_cdr(outgoing.landmarks(0, 'map', [], np.empty((0, 2)), np.empty((0, 2, 2))))

    assert (message.width, len(message.data), len(message.fields)) == (0, 0, 9)


def test_a_path_has_the_stamps_of_its_poses_and_the_last_one_in_its_header():
    path = through_cdr(outgoing.path('map', [(5, np.array([1.0, 2, 0])), (7, np.zeros(3))]))

    assert path.header.stamp.nanosec == 7
    assert [(p.header.stamp.nanosec, p.header.frame_id) for p in path.poses] == [
        (5, 'map'), (7, 'map')]
    assert (path.poses[0].pose.position.x, path.poses[0].pose.position.y) == (1.0, 2.0)


def test_frames_that_have_not_joined_are_drawn_at_the_origin():
    transforms = through_cdr(outgoing.view_frames(7, ['r1', 'r2'])).transforms

    assert [(t.header.frame_id, t.child_frame_id) for t in transforms] == [
        ('map', 'r1/map'), ('map', 'r2/map')]
    assert {(t.transform.translation.x, t.transform.rotation.w)
            for t in transforms} == {(0.0, 1.0)}


def test_a_rejection_has_all_known_values_and_no_others():
    gated = Rejection('r1', 5, RejectionReason.GATED, id=3, d2=20.5, threshold=13.8, observed='r3')
    late = Rejection('r1', 5, RejectionReason.LATE, delay=7)

    statuses = [through_cdr(outgoing.rejection(rejected)) for rejected in (gated, late)]

    assert [(status.message, status.level) for status in statuses] == [('gated', 1), ('late', 1)]
    assert [{v.key: v.value for v in status.values} for status in statuses] == [
        {'robot': 'r1', 'stamp_ns': '5', 'id': '3', 'seen': 'r3', 'reason': 'gated',
         'd2': '20.5', 'threshold': '13.8'},
        {'robot': 'r1', 'stamp_ns': '5', 'reason': 'late', 'delay_ns': '7'}]


def test_a_clock_message_has_its_stamp():
    tick = through_cdr(outgoing.clock(1_000_000_007)).clock

    assert (tick.sec, tick.nanosec) == (1, 7)
