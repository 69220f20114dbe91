# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start poses in a live run that begins after its robots have moved."""

from math import pi

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import PosePrior, PriorMap
from fej_slam_ros.ros.session.late_starts import (
    ArrivedOdometry, LateAnchor, LateStarts, MAX_HELD_ODOMETRY, StartCheck)
from fej_slam_ros.ros.session.log_lines import LogSeverity
from helpers.records import MS, odometry, scan, team

NOISE = np.diag([0.01, 0.01, 0.01])


class Messages:
    """Numbers of missed messages by topic, as a test sets them."""

    def __init__(self, **missed):
        self.by_robot = missed
        self.forgotten = []

    def missed(self, topic):
        return self.by_robot.get(topic.removesuffix('/odom'))

    def forget(self, topic):
        self.forgotten.append(topic)


class Lines:
    """The lines of a log by level."""

    def __init__(self):
        self.infos, self.warnings = [], []

    def add(self, severity, text):
        {LogSeverity.INFO: self.infos, LogSeverity.WARN: self.warnings}[severity].append(text)


class LiveRun:
    """An estimator behind a check of late starts."""

    def __init__(self, *names, messages, prior=None, **options):
        self.estimator = Estimator(team(*names, **options), prior)
        self.messages, self.log = messages, Lines()
        self.check = LateStarts(self.estimator, messages, self.log.add, {})

    def odom(self, robot, ms, pose):
        """Add odometry, and return how many messages are passed on."""
        admitted = self.check.admit(
            ArrivedOdometry(odometry(robot, ms, pose, NOISE), None, None))
        for arrived in admitted:
            self.estimator.add(arrived.record)
        return len(admitted)

    def end(self):
        list(self.estimator.close())
        return self.estimator

    def pose(self, robot):
        return self.end().pose(robot)


def test_with_all_messages_received_the_start_pose_holds_at_the_first_wherever_odometry_begins():
    run = LiveRun('r1', messages=Messages(r1=0), anchor_pose=(1.0, 2.0, 0.0))

    assert run.odom('r1', 0, (70.0, 80.0, 3.0)) == 1

    assert run.pose('r1').pose.tolist() == [1.0, 2.0, 0.0]
    assert run.log.infos == run.log.warnings == []
    assert run.messages.forgotten == ['r1/odom']


def test_a_robot_that_has_not_moved_starts_at_its_start_pose_however_late_it_is_received():
    run = LiveRun('r1', messages=Messages(r1=100_000), anchor_pose=(1.0, 2.0, 0.0))

    assert run.odom('r1', 0, (0.0, 0.0, 0.0)) == 1

    estimate = run.pose('r1')
    assert estimate.pose.tolist() == [1.0, 2.0, 0.0]
    assert not estimate.P.any()


def test_a_robot_that_has_moved_starts_as_far_from_its_start_pose():
    run = LiveRun(
        'r1', 'r2', messages=Messages(r1=0, r2=20),
        known=[('r2', (5.0, 0.0, pi / 2), (0.0, 0.0, 0.0))])
    run.odom('r1', 0, (0.0, 0.0, 0.0))

    assert run.odom('r2', 0, (2.0, 0.0, 0.0)) == 0
    assert run.odom('r2', 100, (2.1, 0.0, 0.0)) == 2

    estimate = run.pose('r2')
    assert estimate.frame == 'map'
    np.testing.assert_allclose(estimate.pose, [5.0, 2.1, pi / 2], atol=1e-12)
    # 21 increments of 0.1 s: the variance of the heading is exact.
    assert estimate.P[2, 2] == pytest.approx(21 * 0.01 * 0.1 ** 2, rel=1e-9)
    line, = run.log.infos
    assert 'r2 had moved by [2.00, 0.00, 0.00]' in line
    assert '(missed messages: 20)' in line


def test_a_robot_whose_first_odometry_a_checkpoint_has_starts_at_its_start_pose():
    run = LiveRun(
        'r1', 'r2', messages=Messages(r1=0, r2=0),
        known=[('r2', (5.0, 0.0, 0.0), (0.0, 0.0, 0.0))])
    run.odom('r2', 0, (0.0, 0.0, 0.0))

    # Restored before r1 has sent anything, so that no step was processed.
    run.check = LateStarts(run.estimator, Messages(r1=0, r2=6), run.log.add, {})
    for ms, x in ((100, 0.1), (200, 0.2)):
        run.odom('r2', ms, (x, 0.0, 0.0))
    run.odom('r1', 0, (0.0, 0.0, 0.0))

    np.testing.assert_allclose(run.pose('r2').pose, [5.2, 0.0, 0.0], atol=1e-12)
    assert run.log.infos == run.log.warnings == []


def test_a_robot_whose_first_odometry_was_held_in_an_earlier_process_starts_there():
    """The period in which no process ran is not that of the messages that were missed."""
    known = [('r2', (5.0, 0.0, 0.0), (0.0, 0.0, 0.0))]
    earlier = LiveRun('r1', 'r2', messages=Messages(r1=0, r2=20), known=known)
    assert earlier.odom('r2', 0, (2.0, 0.0, 0.0)) == 0

    run = LiveRun('r1', 'r2', messages=Messages(r1=0, r2=30), known=known)
    run.check = LateStarts(run.estimator, run.messages, run.log.add, earlier.check.held())
    run.odom('r1', 0, (0.0, 0.0, 0.0))
    assert run.odom('r2', 1000, (3.0, 0.0, 0.0)) == 0
    assert run.odom('r2', 1100, (3.1, 0.0, 0.0)) == 3

    estimate = run.pose('r2')
    np.testing.assert_allclose(estimate.pose, [8.1, 0.0, 0.0], atol=1e-12)
    # 20 increments of 0.1 s were missed, then came one of 1 s and one of 0.1 s.
    assert estimate.P[2, 2] == pytest.approx(0.01 * (20 * 0.1**2 + 1.0 + 0.1**2), rel=1e-9)
    assert '(missed messages: 20)' in run.log.infos[0]


@pytest.mark.parametrize('stamps', [(1100, 1000), (1000, 1000, 1100)])
def test_the_order_of_odometry_after_that_of_an_earlier_process_does_not_matter(stamps):
    earlier = LiveRun('r1', messages=Messages(r1=20), anchor_pose=(1.0, 0.0, 0.0))
    earlier.odom('r1', 0, (2.0, 0.0, 0.0))

    run = LiveRun('r1', messages=Messages(r1=30), anchor_pose=(1.0, 0.0, 0.0))
    run.check = LateStarts(run.estimator, run.messages, run.log.add, earlier.check.held())
    for ms in stamps:
        run.odom('r1', ms, (2.0 + ms / 1000, 0.0, 0.0))

    assert run.pose('r1').P[2, 2] == pytest.approx(0.01 * (20 * 0.1**2 + 1.0 + 0.1**2), rel=1e-9)


def test_the_check_of_replay_passes_on_what_was_held_in_an_earlier_process():
    earlier = LiveRun('r1', 'r2', messages=Messages(r1=20, r2=20), known=[
        ('r2', (5.0, 0.0, 0.0), (0.0, 0.0, 0.0))])
    for robot in ('r1', 'r2'):
        earlier.odom(robot, 0, (2.0, 0.0, 0.0))
    check = StartCheck(earlier.check.held())

    admitted = check.admit(ArrivedOdometry(odometry('r1', 100), None, None))

    assert [(a.record.robot, a.record.stamp) for a in admitted] == [('r1', 0), ('r1', 100 * MS)]
    assert [(a.record.robot, a.record.stamp) for a in check.close()] == [('r2', 0)]


def test_a_start_pose_is_not_used_if_the_motion_since_is_unknown():
    run = LiveRun(
        'r1', 'r2', messages=Messages(r1=0, r2=2),
        known=[('r2', (5.0, 0.0, 0.0), (0.0, 0.0, 0.0))])
    run.odom('r1', 0, (0.0, 0.0, 0.0))

    run.odom('r2', 0, (30.0, 0.0, 0.0))
    run.odom('r2', 100, (30.1, 0.0, 0.0))

    assert run.pose('r2').frame == 'r2/map'
    assert 'too far from its origin' in run.estimator.groups.not_in_map['r2']
    assert 'the start pose of r2 is not used' in run.log.warnings[0]


def test_an_anchor_that_alone_defines_map_does_so_where_it_is_first_received():
    run = LiveRun('r1', 'r2', messages=Messages(r1=2))

    run.odom('r1', 0, (30.0, 0.0, 1.0))
    run.odom('r1', 100, (30.0, 0.0, 1.0))

    assert run.pose('r1').frame == 'map'
    assert run.pose('r1').pose.tolist() == [0.0, 0.0, 0.0]
    assert 'map begins where r1 is now' in run.log.infos[0]


@pytest.mark.parametrize('options', [
    {'anchor_pose': (1.0, 0.0, 0.0)}, {'prior': PriorMap((9,), np.ones((1, 2)), np.eye(2))},
    {'known': [('r2', (5.0, 0.0, 0.0), (0.0, 0.0, 0.0))]}])
def test_an_anchor_in_a_map_that_is_given_begins_in_its_own_frame_until_it_is_placed(options):
    run = LiveRun('r1', 'r2', messages=Messages(r1=2), **options)
    run.odom('r1', 0, (30.0, 0.0, 1.0))
    run.odom('r1', 100, (30.0, 0.0, 1.0))
    run.estimator.add(scan('r1', 100, [(1, (2.0, 0.0))]))
    run.end()
    assert run.estimator.pose('r1').frame == 'r1/map'
    assert 'too far from its origin' in run.log.warnings[0]

    run.estimator.add(PosePrior('r1', 150 * MS, np.array([7.0, 8.0, 0.5]), 0.01 * np.eye(3)))
    run.odom('r1', 200, (30.0, 0.0, 1.0))

    placed = run.pose('r1')
    assert placed.frame == 'map'
    np.testing.assert_allclose(placed.pose, [7.0, 8.0, 0.5], atol=1e-9)


def test_odometry_is_held_only_until_the_number_of_missed_messages_counts_as_unknown():
    run = LiveRun('r1', messages=Messages(), anchor_pose=(1.0, 0.0, 0.0))

    admitted = [run.odom('r1', 100 * k, (3.0, 0.0, 0.0)) for k in range(MAX_HELD_ODOMETRY + 1)]

    assert admitted == [*[0] * (MAX_HELD_ODOMETRY - 1), MAX_HELD_ODOMETRY, 1]
    run.end()
    assert 'unknown how long it had moved' in run.estimator.groups.not_in_map['r1']


def test_odometry_held_at_the_end_of_the_input_is_passed_on():
    run = LiveRun('r1', messages=Messages(r1=7), anchor_pose=(1.0, 0.0, 0.0))
    run.odom('r1', 0, (3.0, 0.0, 0.0))

    assert [arrived.record.stamp for arrived in run.check.close()] == [0]
    assert [*run.check.close()] == []


def test_only_robots_with_a_start_pose_are_checked():
    run = LiveRun(
        'r1', 'r2', 'r3', messages=Messages(r2=9),
        known=[('r3', (5.0, 0.0, 0.0), (0.0, 0.0, 0.0))])

    assert run.check.topics() == ['r1/odom', 'r3/odom']
    assert run.odom('r2', 0, (3.0, 0.0, 0.0)) == 1
    assert StartCheck().topics() == []


@pytest.mark.parametrize(('anchor_pose', 'missed', 'x', 'infos', 'warnings'), [
    ((0.0, 0.0, 0.0), 4, 3.0, 1, 0),
    ((1.0, 0.0, 0.0), 4, 3.0, 0, 1),
    ((1.0, 0.0, 0.0), None, 3.0, 0, 1),
    ((1.0, 0.0, 0.0), 0, 3.0, 0, 0),
    ((1.0, 0.0, 0.0), 4, 0.0, 0, 0),
])
def test_a_smoother_that_receives_its_anchor_late_says_where_map_begins(
    anchor_pose, missed, x, infos, warnings,
):
    messages, log = Messages(r1=missed), Lines()
    check = LateAnchor(team('r1', 'r2', anchor_pose=anchor_pose), messages, log.add)
    assert check.topics() == ['r1/odom']

    for k in range(MAX_HELD_ODOMETRY + 1):
        for robot in ('r1', 'r2'):
            arrived = ArrivedOdometry(odometry(robot, 100 * k, (x, 0.0, 0.0), NOISE), None, None)
            assert check.admit(arrived) == [arrived]

    assert (len(log.infos), len(log.warnings)) == (infos, warnings)
    assert all('first odometry received of r1, [3., 0., 0.]' in line for line in log.infos)
    assert messages.forgotten == ['r1/odom']
    assert check.topics() == []


def test_odometry_whose_stamps_do_not_advance_is_not_held_for_ever():
    run = LiveRun('r1', messages=Messages(r1=3))

    poses = [(5.0 + 0.1 * k, 0.0, 0.0) for k in range(2 * MAX_HELD_ODOMETRY)]
    passed_on = [run.odom('r1', 0, pose) for pose in poses]

    assert passed_on == [0] * (MAX_HELD_ODOMETRY - 1) + [MAX_HELD_ODOMETRY] + [
        1] * MAX_HELD_ODOMETRY
    assert run.log.infos == [
        'map begins where r1 is now: its first 5 odometry messages have no later stamp']
