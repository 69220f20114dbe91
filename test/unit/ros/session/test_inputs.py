# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rejected data is counted by its reason and does not affect anything else."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import NodeSettings, RunSettings
from fej_slam_ros.ros.session import inputs as inputs_module
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.inputs import Inputs, MAX_WAITING_SCANS
from helpers.optional import given, settings, strategies as st
from helpers.records import MS, odometry, team, true_pose
from helpers.ros import (
    cloud, drive, empty_cloud, feed, LANDMARKS, meeting, odometry_message, raw, raw_record,
    run_settings, seen)

#: Odometry of both robots every 100 ms from 0 to 400, with scans from 100 on.
GOOD = [raw_record(record) for record in meeting()]


def run_of(*messages, options=None):
    """Return a run that was given messages, one by one, and then ended."""
    run = EstimatorSession(options or run_settings(), None)
    drive(run, messages)
    return run


def rejection_counts(run, robot='r1'):
    counted = run.estimator.statistics.rejection_counts[robot]
    return {reason.value: n for reason, n in counted.items() if n}


def odom(ms, xyz=(0.0, 0.0, 0.0), received=900, **fields):
    return raw('r1/odom', odometry_message(ms, xyz, **fields), received)


def scan(ms, *observations, frame='', received=900):
    return raw('r1/landmarks', seen(*observations, ms=ms, frame=frame), received)


def cut(message):
    return replace(message, raw=message.raw[:-9])


HASH = run_of(*GOOD).estimator.state_hash()
UPSIDE_DOWN = (1.0, 0.0, 0.0, 0.0)
INDEFINITE = np.diag([1.0, 1.0, 0.0, 0.0, 0.0, -1.0])
WITHOUT_X = cloud({'y': ('f8', [1.0]), 'id': ('i4', [1])}, 400)


@pytest.mark.parametrize(
    ('message', 'reason'),
    [
        (odom(500, (nan, 0.0, 0.0)), 'not_finite'),
        (odom(500, (1e12, 0.0, 0.0)), 'out_of_range'),
        (odom(500, quaternion=(0.0, 0.0, 0.0, 0.0)), 'bad_quaternion'),
        (odom(500, quaternion=UPSIDE_DOWN), 'tilted'),
        (odom(500, twist_covariance=INDEFINITE), 'bad_covariance'),
        (raw('r1/landmarks', WITHOUT_X, 900), 'bad_cloud'),
        (scan(350, (1, 2.0, 3.0), frame='r2/base_link'), 'wrong_frame'),
        (scan(350, (1, 2.0, 3.0), frame='r1'), 'wrong_frame'),
        (scan(350, (1, 2.0, 3.0), frame='map'), 'wrong_frame'),
        (GOOD[0], 'duplicate'),
        (GOOD[-3], 'duplicate'),
        (odom(400, (0.5, 0.0, 0.0)), 'conflicting'),
        (odom(0, (0.5, 0.0, 0.0)), 'conflicting'),
        (odom(50, (0.05, 0.0, 0.0)), 'late'),
        (scan(150, (1, 2.0, 3.0)), 'late'),
        (odom(5901), 'future'),
        (scan(5901, (1, 2.0, 3.0)), 'future'),
        (scan(450, (1, 2.0, 3.0)), 'after_odometry'),
        (cut(odom(500)), 'bad_message'),
        (cut(scan(400, (1, 2.0, 3.0))), 'bad_message'),
        (replace(odom(500), raw=b''), 'bad_message'),
        (raw('r1/odom', seen(ms=500), 900), 'bad_message'),
        (raw('r1/ground_truth', odometry_message(500, (nan, 0.0, 0.0)), 900), 'not_finite'),
    ])
def test_a_rejected_message_is_counted_by_its_reason_and_changes_nothing(message, reason):
    run = run_of(*GOOD, message)

    statistics = run.estimator.statistics
    assert rejection_counts(run) == {reason: 1}
    assert (statistics.received['r1'], statistics.rejected['r1']) == (10, 1)
    assert run.estimator.used('r1') == 9
    assert run.estimator.state_hash() == HASH


def test_a_covariance_that_is_not_used_counts_as_unknown():
    def hash_of(twist_covariance, options):
        run = run_of(*(
            odom(ms, (ms / 1e3, 0.0, 0.0), twist_covariance=twist_covariance)
            for ms in range(0, 500, 100)), options=options)
        assert run.estimator.used('r1') == 5
        return run.estimator.state_hash()

    reading = run_settings('r1')
    r1, = reading.estimation.robots
    ignoring = replace(reading, estimation=replace(
        reading.estimation, robots=(replace(r1, use_odometry_covariance=False),)))

    assert hash_of(INDEFINITE, ignoring) == hash_of(None, reading) != hash_of(np.eye(6), reading)


@pytest.mark.parametrize(
    ('observation', 'reason'),
    [
        ((4, nan, 0.0), 'not_finite'), ((4, 1e12, 0.0), 'out_of_range'),
        ((-2, 2.0, 3.0), 'bad_id'), ((1, -9.0, 3.0), 'gated')])
def test_a_rejected_observation_is_counted_by_its_reason_and_changes_nothing(observation, reason):
    run = run_of(*GOOD, scan(400, observation))

    assert rejection_counts(run) == {reason: 1}
    assert run.estimator.statistics.rejected['r1'] == (reason != 'gated')
    assert run.estimator.statistics.observations_used['r1'] == 4 * len(LANDMARKS)
    assert run.estimator.state_hash() == HASH


def test_a_scan_with_rejected_observations_only_is_no_step():
    run = run_of(*GOOD[:-1], scan(350, (4, nan, 0.0), (-2, 2.0, 3.0)), GOOD[-1])

    assert rejection_counts(run) == {'not_finite': 1, 'bad_id': 1}
    statistics = run.estimator.statistics
    assert (statistics.received['r1'], statistics.rejected['r1']) == (10, 1)
    assert run.estimator.used('r1') == 9
    assert run.estimator.state_hash() == HASH


def test_a_duplicate_id_rejects_both_observations_and_no_others():
    run = run_of(*GOOD, scan(400, (7, 1.0, 0.0), (8, 1.0, 1.0), (7, 3.0, 0.0)))

    assert rejection_counts(run) == {'duplicate_id': 2}
    assert {number for _, number in run.estimator.groups.team.state.landmarks} == {1, 2, 3, 8}


def test_a_scan_before_the_first_odometry_is_rejected():
    run = run_of(scan(-50, (1, 2.0, 3.0), received=0), *GOOD)

    assert rejection_counts(run) == {'before_odometry': 1}
    assert run.estimator.state_hash() == HASH


@pytest.mark.parametrize(('stamp', 'count'), [(5900, {}), (5900 + 1e-6, {'future': 1})])
def test_stamps_more_than_five_seconds_after_reception_are_in_the_future(stamp, count):
    assert rejection_counts(run_of(odom(stamp, received=900))) == count


def test_without_a_clock_no_stamp_is_from_the_future():
    assert rejection_counts(run_of(odom(10**9, received=None))) == {}


def test_a_robot_that_is_not_in_the_team_is_counted_by_its_name():
    stranger = raw('r9/odom', odometry_message(100), 100)

    run = run_of(*GOOD, stranger, stranger)

    assert (rejection_counts(run, 'r9'), rejection_counts(run)) == ({'unknown_robot': 2}, {})
    assert run.estimator.state_hash() == HASH


@pytest.mark.parametrize('topic', [
    'r1/people', 'tf', 'r1/laser/landmarks', 'camera/image',
    # Published by the node itself.
    'estimator/landmarks'])
def test_other_topics_are_counted_and_ignored(topic):
    run = run_of(*GOOD, raw(topic, seen(ms=100), 900))

    assert run.inputs.unused == {topic: 1}
    assert run.estimator.statistics.rejected.total() == 0


def test_an_invalid_true_map_is_counted_without_a_robot():
    bad = raw('ground_truth/landmarks', seen((1, nan, 0.0)))

    run = run_of(*GOOD, bad, cut(bad))

    assert rejection_counts(run, '') == {'not_finite': 1, 'bad_message': 1}
    assert run.estimator.state_hash() == HASH


def test_ground_truth_reaches_the_evaluation():
    truth = [raw_record(true_pose('r1', ms, (ms / 1000.0, 0.0, 0.0))) for ms in range(0, 500, 100)]

    run = run_of(*truth, *GOOD)

    assert run.estimator.evaluation.scores['r1'].steps == 5
    # The meeting is exact but for rounding.
    assert run.estimator.evaluation.scores['r1'].position_rmse() < 1e-12


@pytest.mark.parametrize('slash', ['', '/'])
@pytest.mark.parametrize('frame', ['', 'r1/base_link', 'chassis', 'laser'])
def test_a_scan_may_be_in_one_of_four_frames(frame, slash):
    r1, r2 = team().robots
    options = RunSettings(replace(team(), robots=(replace(r1, sensor_frame=slash + 'laser'), r2)))
    named = odom(-100, (-0.1, 0.0, 0.0), child=slash + 'chassis')

    run = run_of(named, *GOOD, scan(400, (9, 1.0, 1.0), frame=slash + frame), options=options)

    assert rejection_counts(run) == {}
    assert ('', 9) in run.estimator.groups.team.state.landmarks


def test_a_scan_in_another_frame_waits_for_the_child_frame_of_odometry():
    early = [scan(0, (1, 1.0, 1.0), frame='a'), scan(0, (2, 1.0, 2.0), frame='b')]
    run = EstimatorSession(run_settings('r1'), None)

    for message in early:
        run.receive(message)
    before = run.estimator.statistics.received.total()
    drive(run, [odom(0, child='b'), odom(200, child='b')])

    assert (before, run.estimator.statistics.received['r1']) == (0, 4)
    assert rejection_counts(run) == {'wrong_frame': 1}
    flows = run.inputs.health.robots['r1'].flows
    assert [flows[kind].rejected_in_a_row.total() for kind in ('landmarks', 'odom')] == [1, 0]
    assert set(run.estimator.groups.team.state.landmarks) == {('', 2)}


def test_rejected_odometry_defines_no_frame():
    rejected = odom(7000, received=900, child='elsewhere')
    run = run_of(*GOOD, rejected, scan(400, (1, 2.0, 3.0), frame='elsewhere'))

    assert rejection_counts(run) == {'future': 1, 'wrong_frame': 1}
    assert run.estimator.state_hash() == HASH


def test_a_scan_in_a_wrong_frame_is_rejected_at_once_if_the_child_frame_is_known():
    run = EstimatorSession(run_settings(), None)

    run.receive(odom(0))
    run.receive(scan(0, (1, 1.0, 1.0), frame='chassis'))

    assert rejection_counts(run) == {'wrong_frame': 1}


def test_scans_without_odometry_are_rejected_at_the_end():
    run = run_of(*[scan(ms, (1, 1.0, 1.0), frame='chassis') for ms in range(3)])

    assert rejection_counts(run) == {'wrong_frame': 3}


def test_the_number_of_scans_that_wait_for_odometry_is_limited():
    message = scan(0, (1, 1.0, 1.0), frame='chassis')
    run = EstimatorSession(run_settings(), None)

    for _ in range(MAX_WAITING_SCANS + 2):
        run.receive(message)

    assert rejection_counts(run) == {'wrong_frame': 2}


def test_two_different_scans_at_one_stamp_are_both_used():
    run = run_of(*GOOD, scan(400, (8, 1.0, 1.0)), scan(400, (9, 1.0, -1.0)))

    assert rejection_counts(run) == {}
    assert {number for _, number in run.estimator.groups.team.state.landmarks} == {1, 2, 3, 8, 9}
    assert run.estimator.steps['r1'] == 5


def test_an_empty_scan_is_a_step_without_observations():
    run = run_of(*GOOD, raw('r1/landmarks', empty_cloud(350), 900))

    assert rejection_counts(run) == {}
    assert run.estimator.steps['r1'] == 6


def test_the_delay_is_from_stamp_to_reception():
    run = run_of(odom(100, received=150), odom(200, received=230))

    assert run.inputs.health.robots['r1'].delay == 30 * MS


def test_a_message_on_set_pose_joins_a_robot_to_the_map():
    driven = [raw_record(odometry(robot, ms)) for ms in (0, 100) for robot in ('r1', 'r2')]
    said = raw_record(PosePrior('r2', 100 * MS, np.array([1.0, -3.0, 0.5]), 0.01 * np.eye(3)))

    run = run_of(said, *driven)

    state = run.estimator.groups.team.state
    assert run.estimator.groups.not_in_map == {}
    np.testing.assert_allclose(state.estimate(state.robots['r2']), [1.0, -3.0, 0.5], atol=1e-9)


def test_an_estimator_subscribes_to_all_topics_of_its_robots():
    odometry, points = 'nav_msgs/msg/Odometry', 'sensor_msgs/msg/PointCloud2'
    pose = 'geometry_msgs/msg/PoseWithCovarianceStamped'

    assert EstimatorSession(run_settings('a', 'b'), None).inputs.topics == {
        'a/odom': odometry, 'a/landmarks': points, 'a/robots': points,
        'a/ground_truth': odometry, 'a/set_pose': pose,
        'b/odom': odometry, 'b/landmarks': points, 'b/robots': points,
        'b/ground_truth': odometry, 'b/set_pose': pose, 'initialpose': pose,
        'ground_truth/landmarks': points}


def robots(ms, *observations, frame=''):
    return raw('r1/robots', seen(*observations, ms=ms, frame=frame), 900)


BOTH = [raw_record(odometry(robot, ms)) for ms in range(0, 500, 100) for robot in ('r1', 'r2')]


def test_a_robot_observation_makes_one_step_of_both_robots():
    estimator = Estimator(team())
    inputs = Inputs(estimator, NodeSettings())

    for message in (*BOTH, robots(150, (2, 3.0, 1.0))):
        inputs.receive(message)

    (met,) = [result for result in estimator.release() if result.stamp == 150 * MS]
    assert [pose.robot for pose in met.poses] == ['r1', 'r2']
    assert inputs.unused == {}


@pytest.mark.parametrize(('number', 'reason'), [
    (1, 'self_sighting'), (3, 'unknown_robot'), (-1, 'unknown_robot')])
def test_an_observation_of_an_impossible_robot_is_rejected_and_makes_no_step(number, reason):
    estimator = Estimator(team())
    inputs = Inputs(estimator, NodeSettings())

    for message in (*BOTH, robots(150, (number, 3.0, 1.0))):
        inputs.receive(message)

    assert 150 * MS not in [result.stamp for result in estimator.release()]
    assert estimator.statistics.rejection_counts['r1'] == {reason: 1}
    assert (estimator.statistics.rejected['r1'], estimator.used('r1')) == (1, 5)


def refused_of(*messages):
    """Return what an estimator refuses of messages, and the estimator."""
    estimator = Estimator(team())
    inputs = Inputs(estimator, NodeSettings())
    for message in messages:
        inputs.receive(message)
    list(estimator.release())
    return list(estimator.statistics.rejections), estimator


def test_robot_observations_align_the_frames_of_robots():
    rejected, estimator = refused_of(*BOTH, *(robots(ms, (2, 3.0, 1.0)) for ms in (0, 200, 400)))

    assert rejected == []
    assert estimator.statistics.observations_used['r1'] == 3
    assert estimator.groups.not_in_map['r2'].startswith(
        '0 shared landmarks and 3 observations of robots determine the heading to ')


def test_a_gated_robot_observation_is_rejected_with_the_robots_name():
    (rejected,), _ = refused_of(*BOTH, odom(500), robots(450, (2, 3.0, 1.0)))

    assert (rejected.reason, rejected.id, rejected.observed) == ('other_robot_stale', 2, 'r2')


@pytest.mark.parametrize(('numbers', 'reason', 'name'), [
    ((1,), 'self_sighting', 'r1'), ((3,), 'unknown_robot', None),
    ((2, 2), 'duplicate_id', 'r2')])
def test_a_rejected_robot_observation_names_the_robot(numbers, reason, name):
    rejected, _ = refused_of(
        *BOTH, robots(400, *((number, 3.0, k) for k, number in enumerate(numbers))))

    assert {(r.reason, r.id, r.observed) for r in rejected} == {(reason, numbers[0], name)}
    assert len(rejected) == len(numbers)


def test_robot_observations_that_wait_for_their_frame_are_unchanged():
    estimator = Estimator(team())
    inputs = Inputs(estimator, NodeSettings())
    for wrong_or_right in ('chassis', 'elsewhere'):
        inputs.receive(robots(150, (2, 3.0, 1.0), frame=wrong_or_right))
    restored = Inputs(estimator, NodeSettings())

    restored.restore(inputs.snapshot())
    for message in (odom(0, child='chassis'), odom(200, child='chassis'), *BOTH[1::2]):
        restored.receive(message)

    assert estimator.statistics.rejection_counts['r1'] == {'wrong_frame': 1}
    assert 150 * MS in [result.stamp for result in estimator.release()]


INTACT = [
    odom(0), scan(0, (1, 1.0, 2.0)), raw('r1/ground_truth', odometry_message()),
    raw_record(PosePrior('r1', 0, np.zeros(3), np.eye(3)))]


@given(
    st.sampled_from(INTACT), st.dictionaries(st.integers(0, 10**4), st.integers(0, 255)),
    st.integers(1, 800))
@settings(max_examples=100, deadline=None, derandomize=True)
@pytest.mark.filterwarnings('ignore::RuntimeWarning')  # numbers that are none
def test_damaged_bytes_are_counted_and_raise_no_error(intact, damage, length):
    damaged = bytearray(intact.raw[:length])
    for place, value in damage.items():
        damaged[place % len(damaged)] = value
    run = EstimatorSession(run_settings(), None)

    run.receive(RawMessage(intact.topic, intact.type_name, 0, bytes(damaged)))
    run.inputs.close()

    assert run.estimator.statistics.received == {'r1': 1}


@pytest.mark.parametrize('topic', ['r1/landmarks', 'r1/robots'])
def test_a_scan_of_too_many_points_is_rejected_by_its_header(topic):
    crowd = {'x': ('f8', [1.0] * 21), 'y': ('f8', [0.0] * 21)}
    message = raw(topic, cloud(crowd, ms=100), 900)
    # Its points would not even be decoded.
    headless = replace(message, raw=message.raw[:100])

    run = run_of(odom(0), odom(200), message, headless, options=run_settings(max_observations=20))

    assert rejection_counts(run) == {'too_large': 2}
    assert run.inputs.health.flow('r1', topic[3:]).largest.points == 21


def test_a_scan_at_the_limit_is_used():
    crowd = [(number, 1.0, float(number)) for number in range(20)]

    run = run_of(odom(0), odom(200), scan(100, *crowd), options=run_settings(max_observations=20))

    assert rejection_counts(run) == {}
    assert run.estimator.statistics.observations_used['r1'] == 20


def test_a_scan_of_few_but_very_long_points_is_rejected():
    long = cloud({'x': ('f8', [1.0]), 'y': ('f8', [0.0])}, ms=100, pad=200_000)

    assert rejection_counts(run_of(odom(0), raw('r1/landmarks', long))) == {'too_large': 1}


def test_scans_that_wait_for_the_frame_of_odometry_have_limited_bytes(monkeypatch):
    monkeypatch.setattr(inputs_module, 'MAX_WAITING_BYTES', 100)
    scans = [scan(ms, (1, 1.0, 2.0), frame='chassis') for ms in range(0, 70, 10)]

    run = EstimatorSession(run_settings(), None)
    for message in scans:
        run.receive(message)

    # A point has 20 bytes: five scans wait.
    assert [r.stamp for r in run.estimator.statistics.rejections] == [50 * MS, 60 * MS]


def test_a_stamp_with_a_whole_second_of_nanoseconds_is_rejected():
    message = odometry_message(400)
    message.header.stamp.nanosec = 10**9

    assert rejection_counts(run_of(*GOOD, raw('r1/odom', message, 900))) == {'bad_stamp': 1}


def test_a_given_pose_that_is_rejected_is_not_why_a_robot_is_in_map():
    from_the_future = PosePrior('r2', 10**6 * MS, np.zeros(3), np.eye(3))

    run = run_of(*GOOD, replace(raw_record(from_the_future), received=900 * MS))

    assert rejection_counts(run, 'r2') == {'future': 1}
    assert run.inputs.health.pose_priors == {}


def test_a_scan_that_has_waited_in_vain_is_a_rejected_message_of_its_topic():
    run = run_of(scan(0, (1, 1.0, 1.0), frame='a'))

    assert rejection_counts(run) == {'wrong_frame': 1}
    assert run.inputs.health.flow('r1', 'landmarks').rejected_in_a_row.total() == 1


def test_scans_whose_stamps_are_far_behind_are_rejected_messages_of_their_topic():
    """They are held until odometry shows that time has not jumped, and rejected only then."""
    messages = [
        message for ms in range(30_000, 33_000, 100) for message in (
            raw('r1/odom', odometry_message(ms, (0.0, 0.0, 0.0)), ms),
            raw('r1/landmarks', seen((1, 5.0, 1.0), ms=ms - 20_000), ms))]
    run = EstimatorSession(run_settings('r1'), None)

    list(feed(run, messages))

    flows = run.inputs.health.robots['r1'].flows
    assert not flows['odom'].rejected_in_a_row
    # The first one was in order when it came, and the last one is still held.
    assert flows['landmarks'].rejected_in_a_row == {RejectionReason.BEFORE_ODOMETRY: 28}
    assert flows['landmarks'].are_all_rejected(33_000 * MS)
