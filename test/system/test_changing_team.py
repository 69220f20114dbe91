# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots that join or leave during a run do not affect the others, and may return."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import NS, Odometry, PosePrior, Scan, TrueLandmarks
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.core.snapshot import restore, snapshot
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import circles, frames, pose_difference, whole_state
from helpers.records import MS, odometry, scan, team

#: Where FEJ is consistent at all; sees a few landmarks at a time.
SENSORS = SensorSettings((0.05, 0.05, 0.01), (0.1, 0.1), range=25.0)
#: Steps are 200 ms apart; the run takes 12.6 s.
RUN = circles(4, robots=3, landmarks=30, sensors=SENSORS)
R1, R2, R3 = (RobotSettings(f'r{k}', k) for k in (1, 2, 3))
HALF = 6 * NS


def records_of(*names, records=RUN):
    """Return what the robots of some names send."""
    return [r for r in records if isinstance(r, TrueLandmarks) or r.robot in names]


def drive(estimator, records, since=0, until=NS * 10**6):
    """Give an estimator the records of a time, and do the steps that are due."""
    results = []
    for record in records:
        if since <= record.stamp < until:
            estimator.add(record)
            results += estimator.take()
    return results


def ended(estimator):
    list(estimator.close())
    return estimator


def test_removing_a_robot_only_marginalizes_it():
    estimator = Estimator(team())
    drive(estimator, records_of('r1', 'r2'), until=HALF)
    poses, points, P = whole_state(estimator)
    landmarks = list(estimator.groups.team.state.landmarks)

    estimator.change_team([R1])

    after, same_points, same_P = whole_state(estimator)
    others = np.delete(np.arange(len(P)), [3, 4, 5])
    assert list(estimator.groups.team.state.landmarks) == landmarks
    assert_array_equal(after, poses[:1])
    assert_array_equal(same_points, points)
    assert_array_equal(same_P, P[np.ix_(others, others)])


def test_other_robots_continue_as_if_a_removed_robot_were_silent():
    silent, left = (Estimator(team()) for _ in range(2))
    for estimator in (silent, left):
        drive(estimator, records_of('r1', 'r2'), until=HALF)
        # All that waits for its time is used, so that both know the same.
        list(estimator.release())
    left.change_team([R1])
    for estimator in (silent, left):
        drive(estimator, records_of('r1'), since=HALF)
        ended(estimator)

    poses, points, P = whole_state(left)
    expected_poses, expected_points, expected_P = whole_state(silent)
    assert len(silent.groups.team.state.robots) == 2
    # The same numbers in another order of the slots: rounding only.
    assert_allclose(poses, expected_poses[:1], atol=1e-10)
    assert_allclose(points, expected_points, atol=1e-10)
    others = np.delete(np.arange(len(expected_P)), [3, 4, 5])
    assert_allclose(P, expected_P[np.ix_(others, others)], atol=1e-10)


def test_an_added_robot_equals_one_that_was_silent_before():
    always, added = Estimator(team('r1', 'r2', 'r3')), Estimator(team('r1', 'r2'))
    early, late = records_of('r1', 'r2'), [r for r in RUN if r.stamp >= HALF]
    for estimator in (always, added):
        drive(estimator, early, until=HALF)
        estimator.change_team([R1, R2, R3])
        drive(estimator, late)
        ended(estimator)

    assert added.state_hash() == always.state_hash()
    assert added.groups.team.state.robots.keys() == {'r1', 'r2', 'r3'}
    assert added.groups.not_in_map == {}


def test_robots_are_processed_in_the_order_of_the_new_list():
    estimator = Estimator(team('r1', 'r2'))
    drive(estimator, RUN, until=HALF)
    estimator.change_team([R3, R2, R1])

    results = drive(estimator, RUN, since=HALF)

    assert [pose.robot for pose in results[-1].poses] == ['r3', 'r2', 'r1']


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_robot_that_returns_elsewhere_relocalizes_by_landmarks(seed):
    records = circles(seed, landmarks=30, sensors=SENSORS, loops=2)
    estimator = Estimator(team())
    drive(estimator, records, until=HALF)
    estimator.change_team([R1])
    drive(estimator, records_of('r1', records=records), since=HALF, until=2 * HALF)
    estimator.change_team([R1, R2])

    results = drive(estimator, [switched_on(r, 2 * HALF) for r in records], since=2 * HALF)

    poses = [pose for result in results for pose in result.poses if pose.robot == 'r2']
    assert poses[-1].frame == 'map'
    error = pose_difference(poses[-1].pose, estimator.truth.pose('r2', poses[-1].stamp))
    # Chi-square with 3 degrees of freedom is below 30 but for 1 in a million.
    assert error @ np.linalg.solve(poses[-1].P, error) < 30.0


def switched_on(record, stamp):
    """Let the odometry of a robot restart at a stamp."""
    if not isinstance(record, Odometry) or record.robot != 'r2' or record.stamp < stamp:
        return record
    return replace(record, pose=record.pose + np.array([7.0, -3.0, 0.0]))


def test_the_configured_start_pose_does_not_apply_to_a_robot_that_returns():
    estimator = Estimator(team('r1', 'r2', known=[('r2', (5.0, 0.0, 0.0), (0.1, 0.1, 0.1))]))
    estimator.add(odometry('r1', 0))
    estimator.add(odometry('r2', 0))
    list(estimator.release())
    robots = list(estimator.robots.values())
    assert 'r2' in estimator.groups.team.state.robots
    estimator.change_team(robots[:1])
    estimator.change_team(robots)

    estimator.add(odometry('r2', 1000))

    (pose,) = [pose for result in estimator.release() for pose in result.poses]
    assert (pose.robot, pose.frame) == ('r2', 'r2/map')


def test_queued_messages_of_a_removed_robot_are_rejected_as_left():
    estimator = Estimator(team())
    for ms in (0, 100, 200):
        estimator.add(odometry('r2', ms))
    estimator.add(scan('r2', 150, [(1, (1.0, 0.0))]))
    estimator.add(PosePrior('r2', 300 * MS, np.zeros(3), np.eye(3)))

    estimator.change_team([R1])
    estimator.add(odometry('r2', 300))

    assert estimator.statistics.rejection_counts['r2'] == {
        RejectionReason.LEFT: 5, RejectionReason.UNKNOWN_ROBOT: 1}
    assert estimator.used('r2') == 0


def test_messages_used_before_a_robot_left_are_not_used_again():
    estimator = Estimator(team())
    early = [
        r for r in records_of('r1', 'r2')
        if r.stamp < HALF and not isinstance(r, TrueLandmarks)]
    drive(estimator, early)
    list(estimator.release())
    estimator.change_team([R1])
    estimator.change_team([R1, R2])
    expected = estimator.state_hash()

    drive(estimator, early)
    ended(estimator)

    assert estimator.state_hash() == expected
    sent = sum(isinstance(r, (Odometry, Scan)) for r in early)
    assert estimator.statistics.total(RejectionReason.DUPLICATE) == sent


def test_the_anchor_may_leave_after_it_has_observed_a_landmark():
    estimator = Estimator(team())
    assert [estimator.groups.may_leave(name) for name in ('r1', 'r2')] == [False, True]
    drive(estimator, records_of('r1', 'r2'), until=HALF)

    assert estimator.groups.may_leave('r1')
    estimator.change_team([R2])
    results = drive(estimator, records_of('r2'), since=HALF)

    assert {pose.frame for result in results for pose in result.poses} == {'map'}


def group_of_two(estimator):
    """Let r2 and r3 map together, far from where r1 is."""
    for ms in (0, 100, 200):
        for name in ('r1', 'r2', 'r3'):
            estimator.add(odometry(name, ms))
        estimator.add(scan('r1', ms, [(99, (1.0, 1.0))]))
        for name in ('r2', 'r3'):
            estimator.add(scan(name, ms, [(1, (3.0, 1.0)), (2, (2.0, -2.0)), (3, (-1.0, 2.0))]))
    list(estimator.release())


def test_a_frame_whose_owner_leaves_is_renamed_after_the_next_robot():
    estimator = Estimator(team('r1', 'r2', 'r3'))
    group_of_two(estimator)
    assert frames(estimator)['r2/map'].robots.keys() == {'r2', 'r3'}

    estimator.change_team([R1, R3])

    assert list(frames(estimator)) == ['map', 'r3/map']
    assert frames(estimator)['r3/map'].robots.keys() == {'r3'}
    assert len(frames(estimator)['r3/map'].landmarks) == 3


def test_the_map_of_removed_robots_joins_when_the_team_observes_its_landmarks():
    estimator = Estimator(team('r1', 'r2', 'r3'))
    group_of_two(estimator)
    estimator.change_team([R1])
    assert list(frames(estimator)) == ['map', 'r3/map']
    inner = [(1, (3.2, 1.0)), (2, (2.2, -2.0))]

    for ms in (300, 400):
        estimator.add(odometry('r1', ms))
        estimator.add(scan('r1', ms, [*inner, (3, (-0.8, 2.0))]))
    ended(estimator)

    assert list(frames(estimator)) == ['map']
    assert {number for _, number in estimator.groups.team.state.landmarks} == {1, 2, 3, 99}


def test_a_changed_team_survives_a_checkpoint():
    settings = team()
    undisturbed, stopped = Estimator(settings), Estimator(settings)
    for estimator in (undisturbed, stopped):
        drive(estimator, RUN, until=HALF)
        estimator.change_team([R1, R3])

    continued = restore(snapshot(stopped), settings, Estimator)
    for estimator in (undisturbed, continued):
        drive(estimator, RUN, since=HALF)
        ended(estimator)

    assert list(continued.robots) == ['r1', 'r3']
    assert continued.state_hash() == undisturbed.state_hash()
    assert continued.statistics.rejection_counts == undisturbed.statistics.rejection_counts
