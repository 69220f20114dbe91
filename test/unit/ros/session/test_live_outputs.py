# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live run predicts the pose of a robot at each of its odometry messages, without delay."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.ros.messages import outgoing
from fej_slam_ros.ros.session.estimator_outputs import EstimatorOutputs
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.live_outputs import LiveOutputs
from helpers.records import MS, odometry
from helpers.ros import (
    drive, header, LANDMARKS, meeting, odometry_message, raw, raw_record, run_settings, seen,
    through_cdr)

PREDICTED = {'r1/predicted_pose', 'r1/odometry/filtered', '/tf'}


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def live(*names, is_wanted=lambda topic: True, **changes):
    settings = run_settings(*names, **changes)
    run = EstimatorSession(settings, None, outputs=LiveOutputs)
    run.outputs.is_wanted = is_wanted
    return run


def received(run, messages):
    """Return what a run publishes on reception of messages, and what in steps."""
    at_once, in_steps = [], []
    for message in messages:
        at_once += run.receive(message)
        in_steps += run.take()
    return at_once, in_steps


def ahead(since, until, robot='r1'):
    """Return odometry of one robot every 20 ms."""
    return [raw_record(odometry(robot, ms)) for ms in range(since, until, 20)]


def test_a_slow_robot_does_not_delay_the_predicted_poses_of_another():
    run = live(max_delay=0.0, stale_after=2.0)
    received(run, [raw_record(odometry(robot, ms)) for ms in (0, 20) for robot in ('r1', 'r2')])

    at_once, in_steps = received(run, ahead(40, 1000))

    assert [stamp_of(m) // MS for topic, m in at_once if topic == 'r1/predicted_pose'] == [
        *range(40, 1000, 20)]
    assert {topic for topic, _ in at_once} == PREDICTED
    assert {topic for topic, _ in in_steps} & PREDICTED == set()


def test_the_predicted_pose_continues_the_settled_pose_in_its_frame():
    run = live()
    received(run, map(raw_record, meeting()))

    at_once, _ = received(run, [raw_record(odometry('r2', 460))])

    predicted, fused = (dict(at_once)[f'r2/{kind}'] for kind in (
        'predicted_pose', 'odometry/filtered'))
    assert predicted.header.frame_id == fused.header.frame_id == 'map'
    # Robot r2 started at (1, -3) in map and drives straight ahead at 1 m/s.
    at = predicted.pose.pose.position
    np.testing.assert_allclose([at.x, at.y], [1.46, -3.0], atol=1e-9)
    assert fused.pose.pose.position == at


def test_the_fused_odometry_has_the_velocity_and_the_base_frame_of_the_odometry():
    run = live('r1', max_delay=0.0)
    received(run, [raw('r1/odom', odometry_message(0, child='base_footprint'), 0)])
    message = odometry_message(20, twist_covariance=0.1 * np.eye(6), child='base_footprint')
    message.twist.twist.linear.x = 0.7

    at_once, in_steps = received(run, [raw('r1/odom', message, 20)])

    fused = through_cdr(dict([*at_once, *in_steps])['r1/odometry/filtered'])
    assert (fused.child_frame_id, fused.twist.twist.linear.x) == ('base_footprint', 0.7)
    np.testing.assert_array_equal(fused.twist.covariance, message.twist.covariance)


def test_no_transform_is_later_than_stamps_can_be():
    pose = PoseEstimate(
        'r1', 2**31 * 10**9 - 5, 'map', np.zeros(3), np.eye(3))

    message = outgoing.transforms([pose], {'r1': np.zeros(3)}, {'r1': 'r1/odom'}, 10**9)

    stamp = message.transforms[0].header.stamp
    assert (stamp.sec, stamp.nanosec) == (2**31 - 1, 999_999_999)


@pytest.mark.parametrize('tolerance', [0.0, 0.1])
def test_the_transform_is_post_dated_and_leads_from_odometry_to_the_predicted_pose(tolerance):
    run = live(
        'r1', max_delay=0.0, anchor_pose=(7.0, -3.0, np.pi / 2), transform_tolerance=tolerance)
    received(run, ahead(0, 100))

    at_once, in_steps = received(run, [raw_record(odometry('r1', 100))])

    assert 'r1/pose' in dict(in_steps)
    assert '/tf' not in dict(in_steps)
    (transform,) = dict(at_once)['/tf'].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ('map', 'r1/odom')
    assert stamp_of(transform) == 100 * MS + tolerance * 1e9
    # The origin of the odometry is the start, which looks to the left.
    translation, turned = transform.transform.translation, transform.transform.rotation
    np.testing.assert_allclose([translation.x, translation.y], [7.0, -3.0], atol=1e-12)
    np.testing.assert_allclose([turned.z, turned.w], [np.sqrt(0.5)] * 2, atol=1e-12)


def test_old_repeated_and_rejected_odometry_gives_no_prediction():
    run = live('r1', max_delay=0.0)
    received(run, ahead(0, 200))

    bad = replace(odometry_message(220), header=header(220, 'r1/odom'))
    bad.pose.pose.position.x = float('nan')
    at_once, _ = received(run, [
        raw_record(odometry('r1', 180)), raw_record(odometry('r1', 170)),
        raw('r1/odom', bad, 220)])

    assert at_once == []


def test_odometry_that_came_before_the_first_step_is_predicted_after_it():
    run = live(max_delay=0.0)

    at_once, in_steps = received(run, [*ahead(0, 100), *ahead(0, 40, 'r2')])

    assert [(t, stamp_of(m) // MS) for t, m in in_steps if t == 'r1/predicted_pose'] == [
        ('r1/predicted_pose', 80)]
    assert {topic.partition('/')[0] for topic, _ in at_once} <= {'r2', ''}


def test_only_wanted_messages_are_made():
    run = live(
        'r1', is_wanted=lambda topic: topic == 'r1/odometry/filtered', max_delay=0.0)
    received(run, ahead(0, 100))

    at_once, _ = received(run, ahead(100, 120))

    assert [topic for topic, _ in at_once] == ['r1/odometry/filtered']


def test_a_message_of_one_robot_asks_for_the_subscribers_of_no_other():
    # A question takes microseconds: of fifty robots at each message of each, more than all else.
    asked = []
    run = live(is_wanted=lambda topic: asked.append(topic) or False, max_delay=0.0)
    received(run, [*ahead(0, 100), *ahead(0, 100, 'r2')])
    asked.clear()

    received(run, ahead(100, 120, 'r2'))

    assert asked
    assert not any(topic.startswith('r1/') for topic in asked)


def test_a_removed_robot_is_predicted_no_more():
    run = live()
    received(run, map(raw_record, meeting()))

    run.change_team(['r1'])
    at_once, in_steps = received(run, ahead(500, 600, 'r2'))

    assert not any(topic.startswith('r2/') for topic, _ in [*at_once, *in_steps])
    assert not any(topic.startswith('r2/') for topic in run.outputs.topics)


def test_predictions_change_no_settled_number():
    messages = [*map(raw_record, meeting()), raw('r1/landmarks', seen((1, *LANDMARKS[1]), ms=450))]

    hashes = []
    for outputs in (LiveOutputs, EstimatorOutputs):
        run = EstimatorSession(run_settings(), None, outputs=outputs)
        published = drive(run, messages)
        poses = [through_cdr(m) for topic, m in published if topic.endswith('/pose')]
        hashes.append((run.estimator.state_hash(), str(poses)))

    assert hashes[0] == hashes[1]


def test_a_recorded_run_publishes_no_predictions():
    run = EstimatorSession(run_settings(), None)

    published = drive(run, map(raw_record, meeting()))

    assert not any('predicted' in topic or 'filtered' in topic for topic, _ in published)
    assert not any('predicted' in topic for topic in run.outputs.topics)


def test_every_prediction_is_listed_in_topics_with_its_type():
    run = live()

    at_once, in_steps = received(run, map(raw_record, meeting()))

    assert {topic for topic, _ in at_once} == PREDICTED | {
        'r2/predicted_pose', 'r2/odometry/filtered'}
    for topic, message in [*at_once, *in_steps]:
        assert run.outputs.topics[topic] == message.__msgtype__


def test_the_tolerance_of_transforms_can_change_during_the_run():
    run = live('r1', max_delay=0.0)
    received(run, ahead(0, 100))

    run.change_node_settings(replace(run.settings.node, transform_tolerance=0.5))
    at_once, _ = received(run, [raw_record(odometry('r1', 100))])

    assert stamp_of(dict(at_once)['/tf'].transforms[0]) == 600 * MS
