# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans in the frame of a sensor are used at the place that static transforms give it."""

import json

import numpy as np
import pytest

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.parameters import parse
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.ros import (
    csv_rows, mounts, odometry_message, raw, run_verb, seen, write_bag, write_parameters)

LEFT = (0.0, 0.0, np.pi / 2)
#: A mast 0.5 m ahead and 1 m high that looks to the left, and a laser 0.2 m ahead of it.
MAST = ('r1/base_link', 'r1/mast', (0.5, 0.0, 1.0), LEFT)
LASER = ('r1/mast', 'r1/laser', (0.2, 0.0, 0.1), (0.0, 0.0, 0.0))


def scan(frame, ms=0):
    """Return a scan of one landmark 2 m ahead of the sensor."""
    return raw('r1/landmarks', seen((1, 2.0, 0.0), ms=ms, frame=frame), ms)


def run_of(*messages, **values):
    run = EstimatorSession(parse({'robots': ['r1', 'r2'], **values}), None)
    for message in [raw('r1/odom', odometry_message(0), 0), *messages]:
        list(run.receive(message))
    list(run.close())
    return run


def landmark(run):
    (found,) = run.estimator.landmarks()
    return found.position


@pytest.mark.parametrize('order', [1, -1])
def test_links_are_composed_from_the_base_to_the_sensor(order):
    run = run_of(mounts(*[MAST, LASER][::order]), scan('r1/laser'))

    # 0.5 m ahead, from there 0.2 m and then 2 m to the left.
    np.testing.assert_allclose(landmark(run), [0.5, 2.2], atol=1e-12)


def test_the_base_of_the_odometry_may_be_on_another_branch_than_the_sensor():
    # The footprint is 0.3 m behind base_link and turned to the left, as is the mast.
    footprint = ('base_link', 'base_footprint', (-0.3, 0.0, -0.1), LEFT)
    mast = ('base_link', 'r1/mast', (0.5, 0.0, 1.0), LEFT)

    run = run_of(
        mounts(footprint, mast, LASER),
        raw('r1/odom', odometry_message(10, child='base_footprint'), 10), scan('r1/laser', 10))

    # From the footprint, 0.8 m to the right and 2.2 m ahead.
    np.testing.assert_allclose(landmark(run), [2.2, -0.8], atol=1e-12)


def test_links_of_several_messages_are_one_tree():
    run = run_of(mounts(LASER), mounts(MAST), scan('/r1/laser'))

    np.testing.assert_allclose(landmark(run), [0.5, 2.2], atol=1e-12)


def test_the_parameters_override_static_transforms():
    run = run_of(
        mounts(MAST, LASER), scan('r1/laser'),
        **{'r1.sensor_frame': 'r1/laser', 'r1.sensor_pose': [1.0, 0.0, 0.0]})

    np.testing.assert_allclose(landmark(run), [3.0, 0.0], atol=1e-12)


def test_a_scan_in_the_base_frame_needs_no_transform():
    run = run_of(mounts(MAST, LASER), scan('r1/base_link'))

    np.testing.assert_allclose(landmark(run), [2.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ('links', 'reason'),
    [
        ((), RejectionReason.WRONG_FRAME),
        ((LASER,), RejectionReason.WRONG_FRAME),
        ((LASER, ('r1/laser', 'r1/mast', (0.0, 0.0, 0.0), LEFT)), RejectionReason.WRONG_FRAME),
        ((('r1/base_link', 'r1/laser', (0.0, 0.0, 0.0), (np.pi, 0.0, 0.0)),),
         RejectionReason.TILTED),
        ((('r1/base_link', 'r1/laser', (0.0, 0.0, 0.0), (-np.pi / 2, 0.0, -np.pi / 2)),),
         RejectionReason.TILTED),
    ],
)
def test_a_scan_without_an_upright_place_on_its_robot_is_rejected(links, reason):
    run = run_of(mounts(*links), scan('r1/laser'))

    assert run.estimator.statistics.rejection_counts['r1'] == {reason: 1}


@pytest.mark.parametrize(('coordinate', 'reason'), [
    (np.nan, RejectionReason.NOT_FINITE), (1e38, RejectionReason.OUT_OF_RANGE),
    (-1e300, RejectionReason.OUT_OF_RANGE)])
def test_a_transform_that_is_no_place_is_rejected_and_counted(coordinate, reason):
    link = 'r1/base_link', 'r1/laser', (0.0, coordinate, 0.0), LEFT

    run = run_of(mounts(link), scan('r1/laser'))

    assert run.estimator.statistics.rejection_counts[''] == {reason: 1}
    assert run.estimator.statistics.rejection_counts['r1'] == {RejectionReason.WRONG_FRAME: 1}


def test_a_scan_of_a_sensor_far_from_its_robot_is_rejected_and_changes_nothing():
    # As of a site in the frame of the Earth.
    far = 'r1/base_link', 'r1/laser', (0.0, 6.4e6, 0.0), LEFT

    run = run_of(mounts(far), scan('r1/laser', 10))

    assert run.estimator.statistics.rejection_counts['r1'] == {RejectionReason.OUT_OF_RANGE: 1}
    assert run.estimator.state_hash() == run_of(mounts(far)).estimator.state_hash()


def test_the_other_links_of_a_message_with_a_wrong_one_are_used():
    wrong = ('r1/base_link', 'r1/arm', (np.inf, 0.0, 0.0), LEFT)

    run = run_of(mounts(wrong, MAST, LASER), scan('r1/laser'))

    np.testing.assert_allclose(landmark(run), [0.5, 2.2], atol=1e-12)
    assert run.estimator.statistics.rejection_counts[''] == {RejectionReason.NOT_FINITE: 1}


@pytest.mark.parametrize(
    ('tf_topics', 'topic', 'used'),
    [
        ('shared', 'tf_static', True), ('shared', 'r1/tf_static', False),
        ('robot', 'tf_static', False), ('robot', 'r1/tf_static', True),
        ('robot', 'r2/tf_static', False), ('both', '/tf_static', True),
        ('both', 'r1/tf_static', True),
    ],
)
def test_static_transforms_come_on_the_topics_beside_those_of_tf(tf_topics, topic, used):
    run = run_of(mounts(MAST, LASER, topic=topic), scan('r1/laser'), tf_topics=tf_topics)

    assert run.estimator.statistics.observations_used['r1'] == used


def test_a_scan_that_waits_for_odometry_is_used_at_its_mount():
    run = EstimatorSession(parse({'robots': ['r1']}), None)
    message = odometry_message(0, child='torso')

    for arrived in (
            scan('laser'), mounts(('torso', 'laser', (0.0, 0.0, 1.0), LEFT)),
            raw('r1/odom', message, 0)):
        list(run.receive(arrived))
    list(run.close())

    np.testing.assert_allclose(landmark(run), [0.0, 2.0], atol=1e-12)


def test_a_restored_run_knows_the_mounts():
    first, second = (EstimatorSession(parse({'robots': ['r1']}), None) for _ in range(2))
    first.receive(mounts(MAST, LASER))

    second.inputs.restore(json.loads(json.dumps(first.inputs.snapshot())))
    for message in (raw('r1/odom', odometry_message(0), 0), scan('r1/laser')):
        list(second.receive(message))
    list(second.close())

    np.testing.assert_allclose(landmark(second), [0.5, 2.2], atol=1e-12)


def test_a_run_that_follows_another_knows_its_mounts_which_are_sent_once():
    first = run_of(mounts(MAST, LASER))
    second = EstimatorSession(first.next_settings(output=''), None)

    second.continue_from(first)
    for message in (raw('r1/odom', odometry_message(0), 0), scan('r1/laser')):
        list(second.receive(message))
    list(second.close())

    np.testing.assert_allclose(landmark(second), [0.5, 2.2], atol=1e-12)


def test_replay_reads_the_mounts_from_the_bag(tmp_path):
    bag = write_bag(tmp_path / 'bag', [
        mounts(MAST, LASER), raw('r1/odom', odometry_message(0), 0), scan('r1/laser')])
    parameters = write_parameters(tmp_path / 'team.yaml', robots=['r1'])

    assert run_verb('replay', bag, '--params', parameters, '--output', tmp_path / 'out') == 0

    (row,) = csv_rows(tmp_path / 'out' / 'landmarks.csv')
    assert (float(row['x']), float(row['y'])) == pytest.approx((0.5, 2.2), abs=1e-12)


def test_the_settings_of_the_robot_stay_without_a_mount():
    run = run_of(mounts(MAST, LASER), scan('r1/laser'))

    assert run.estimator.robots['r1'] == RobotSettings('r1', 1)
