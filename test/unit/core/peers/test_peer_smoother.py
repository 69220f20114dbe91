# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The trajectory of a robot continues from the solution of all that it knows of others."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.peers.peer_smoother import PeerSmoother
from fej_slam_ros.core.peers.team_logs import TeamLogs
from fej_slam_ros.core.peers.union import smoothed_union
from fej_slam_ros.core.rejections import RejectionReason
from helpers.csam import smoothed
from helpers.records import odometry, robot_scan, scan, team

#: Landmarks around the straight path of the robot.
POINTS = {1: (4.0, 3.0), 2: (5.0, -2.0), 3: (1.0, -4.0)}


def seen(ms):
    """Return a scan from the true pose at a time, at 1 m/s along x."""
    return scan('r1', ms, [(id_, (x - ms / 1000.0, y)) for id_, (x, y) in POINTS.items()])


def moved(ms):
    return odometry('r1', ms, (ms / 1000.0, 0.0, 0.0))


def test_a_scan_that_was_in_flight_is_used_with_the_landmarks_known_before():
    settings = team('r1', 'r2')
    own = PeerSmoother(settings, 'r1', TeamLogs('r1', 1, settings.robots[0]), 10**9)
    before = [record for ms in range(0, 3000, 100) for record in (seen(ms), moved(ms))]
    later = [seen(2850), *map(moved, range(3000, 3300, 100))]

    for record in before:
        own.add(record)
        list(own.take())
    task = own.union_task()
    for record in later:
        own.add(record)
        list(own.take())
    own.adopt_union(smoothed_union(task))
    central, _ = smoothed(
        sorted([*before, *later], key=lambda record: record.stamp), settings)

    newest = own.trajectories['r1'].newest()
    expected = next(
        estimate for estimate in central.trajectories['r1'].estimates()
        if estimate.stamp == newest.stamp)
    # The filter linearises where it is, on a nearly noise-free path: a percent.
    assert_allclose(np.diag(newest.P), np.diag(expected.P), rtol=0.01)


def test_with_keyframes_the_own_trajectory_is_that_of_the_union():
    """Which has further keyframes of this robot, at which the other one observed it."""
    settings = replace(team('r1', 'r2'), keyframe_distance=1.0)
    logs = {robot.name: TeamLogs(robot.name, 1, robot) for robot in settings.robots}
    own = PeerSmoother(settings, 'r1', logs['r1'], 10**9)
    for record in (record for ms in range(0, 9000, 100) for record in (seen(ms), moved(ms))):
        own.add(record)
        list(own.take())
    for ms in range(0, 9000, 100):
        # Its keyframes are each 1.5 s, those of r1 each second.
        logs['r2'].record(odometry('r2', ms, (0.7 * ms / 1000.0, 0.0, 0.0)))
        if ms % 500 == 300:
            logs['r2'].record(robot_scan('r2', ms, [('r1', (0.3 * ms / 1000.0 - 2.0, 5.0))]))
    logs['r2'].flush()
    for block in logs['r2'].take_new_blocks():
        logs['r1'].add(block)

    union = smoothed_union(own.union_task())
    own.adopt_union(union)

    expected = {estimate.stamp: estimate for estimate in union.trajectories['r1'].estimates()}
    kept = [*own.trajectories['r1'].estimates()]
    assert 9 <= len(kept) < len(expected)
    for estimate in kept:
        assert_allclose(estimate.pose, expected[estimate.stamp].pose, rtol=0.0, atol=1e-12)
        assert_allclose(estimate.P, expected[estimate.stamp].P, rtol=0.0, atol=1e-12)
    # The newest pose is not kept, and still the newest.
    assert own.trajectories['r1'].newest().stamp > kept[-1].stamp


def test_a_robot_that_stands_still_uses_its_observations_of_others_as_these_do():
    """Its last keyframe is its first pose; it observes the other one long after that."""
    settings = replace(team('r1', 'r2'), keyframe_distance=1.0)
    logs = {robot.name: TeamLogs(robot.name, 1, robot) for robot in settings.robots}
    own = {name: PeerSmoother(settings, name, logs[name], 10**9) for name in logs}
    for ms in range(0, 3000, 100):
        records = [
            odometry('r1', ms, (0.0, 0.0, 0.0)), odometry('r2', ms, (ms / 500.0, 0.0, 0.0))]
        if ms in (500, 2500):
            records.append(robot_scan('r1', ms, [('r2', (ms / 500.0 - 2.0, 5.0))]))
        for record in records:
            own[record.robot].add(record)
    for smoother in own.values():
        list(smoother.close())
        smoother.logs.flush()
    for name, other in (('r1', 'r2'), ('r2', 'r1')):
        for block in logs[name].take_new_blocks():
            if block.log.author == name:
                logs[other].add(block)

    hashes = {smoothed_union(smoother.union_task()).state_hash() for smoother in own.values()}

    assert len(hashes) == 1
    own['r1'].adopt_union(smoothed_union(own['r1'].union_task()))
    assert own['r1'].not_in_map() == {}


def test_robots_with_different_limits_on_scans_have_the_same_map():
    """A robot applies its limit to its own input only."""
    settings = {
        robot: replace(team('r1', 'r2'), max_observations=most)
        for robot, most in (('r1', 3), ('r2', 2))}
    logs = {robot: TeamLogs(robot, 1, settings[robot].robots[0]) for robot in settings}
    own = {robot: PeerSmoother(settings[robot], robot, logs[robot], 10**9) for robot in settings}
    for ms in range(0, 3000, 100):
        for record in (
                seen(ms), moved(ms), odometry('r2', ms, (0.0, 0.0, 0.0)),
                scan('r2', ms, [(1, POINTS[1]), (2, POINTS[2])])):
            assert own[record.robot].add(record) is None
    for name, other in (('r1', 'r2'), ('r2', 'r1')):
        logs[name].flush()
        for block in logs[name].take_new_blocks():
            if block.log.author == name:
                logs[other].add(block)

    maps = [smoothed_union(smoother.union_task()) for smoother in own.values()]

    assert len({union.state_hash() for union in maps}) == 1
    assert {union.statistics.observations_used['r1'] for union in maps} == {90}


def test_a_robot_that_restarts_with_another_max_delay_continues_with_its_own_landmarks():
    """Its log has a scan that came late, with landmarks that others of its scans have not."""
    settings, points = team('r1', 'r2', max_delay=0.5), {
        k: (3.0 * np.cos(k) + 2.0, 3.0 * np.sin(2.1 * k)) for k in range(1, 9)}

    def scan_of(ms, ids):
        return scan('r1', ms, [(k, (points[k][0] - ms / 1000.0, points[k][1])) for k in ids])

    records = [record for ms in range(0, 3000, 100) for record in (
        moved(ms), *([scan_of(ms, [1, 2, 3, 7, 8])] if ms >= 600 and ms % 200 == 0 else []))]
    records.insert(6, scan_of(300, [4, 5, 6, 7, 8]))
    before = TeamLogs('r1', 1, settings.robots[0])
    first = PeerSmoother(settings, 'r1', before, 10**9)
    for record in records:
        assert first.add(record) is None
    before.flush()
    blocks, newest = before.take_new_blocks(), []
    for restarted in (settings, replace(settings, max_delay=0.0)):
        logs = TeamLogs('r1', 2, settings.robots[0])
        for block in blocks:
            logs.restore(block)
        own = PeerSmoother(restarted, 'r1', logs, 10**9)
        list(own.release())
        own.adopt_union(smoothed_union(own.union_task()))
        for ms in range(3000, 3500, 100):
            own.add(moved(ms))
            own.add(scan_of(ms, [1, 2, 3, 7, 8]))
        list(own.release())
        newest.append(own.trajectories['r1'].newest())

    assert_allclose(newest[1].pose, newest[0].pose, atol=1e-6)
    # The filter linearises where it is: a percent.
    assert_allclose(np.diag(newest[1].P), np.diag(newest[0].P), rtol=0.01)


def test_own_observations_of_robots_that_the_union_rejects_are_counted_as_in_the_centre():
    """At the end of the input; the odometry of r2 ends before the observations do."""
    settings = team('r1', 'r2')
    own = PeerSmoother(settings, 'r1', TeamLogs('r1', 1, settings.robots[0]), 10**9)
    other = TeamLogs('r2', 1, settings.robots[1])
    records = [record for ms in range(0, 3000, 100) for record in (
        moved(ms), seen(ms), robot_scan('r1', ms, [('r2', (-ms / 1000.0, 2.0))]))]
    theirs = [odometry('r2', ms, (0.0, 0.0, 0.0)) for ms in range(0, 1500, 100)]
    for record in records:
        assert own.add(record) is None
        list(own.take())
    list(own.close())
    central, _ = smoothed(
        sorted([*records, *theirs], key=lambda record: record.stamp), settings, solved=False)

    own.adopt_finally(smoothed_union(own.union_task()))
    # r2 is unknown: none of 30.
    assert own.statistics.rejection_counts['r1'] == {RejectionReason.OTHER_ROBOT_STALE: 30}
    assert own.statistics.observations_used['r1'] == 90
    for record in theirs:
        other.record(record)
    other.flush()
    for block in other.take_new_blocks():
        own.logs.add(block)
    for _ in range(2):
        own.adopt_finally(smoothed_union(own.union_task()))

    expected = central.statistics
    assert expected.rejection_counts['r1'] == {RejectionReason.OTHER_ROBOT_STALE: 15}
    assert own.statistics.rejection_counts['r1'] == expected.rejection_counts['r1']
    assert own.statistics.observations_used['r1'] == expected.observations_used['r1'] == 105


def test_own_observations_of_robots_outside_the_own_odometry_are_counted_as_in_the_centre():
    settings = team('r1', 'r2')
    logs = {robot.name: TeamLogs(robot.name, 1, robot) for robot in settings.robots}
    own = PeerSmoother(settings, 'r1', logs['r1'], 10**9)
    records = [
        *(robot_scan('r1', ms, [('r2', (0.0, 2.0))]) for ms in (500, 600, 700, 1500, 3500, 3600)),
        *(record for ms in range(1000, 3000, 100) for record in (seen(ms), moved(ms)))]
    records.sort(key=lambda record: record.stamp)
    theirs = [odometry('r2', ms, (ms / 1000.0, 0.0, 0.0)) for ms in range(0, 4000, 100)]
    for record in records:
        own.add(record)
        list(own.take())
    for record in theirs:
        logs['r2'].record(record)
    logs['r2'].flush()
    for block in logs['r2'].take_new_blocks():
        logs['r1'].add(block)
    list(own.close())
    central, _ = smoothed(sorted([*records, *theirs], key=lambda record: record.stamp), settings)

    for _ in range(2):
        own.adopt_finally(smoothed_union(own.union_task()))

    expected = central.statistics
    assert expected.rejection_counts['r1'] == {
        RejectionReason.BEFORE_ODOMETRY: 3, RejectionReason.AFTER_ODOMETRY: 2}
    assert own.statistics.rejection_counts['r1'] == expected.rejection_counts['r1']
    assert own.statistics.observations_used['r1'] == expected.observations_used['r1'] == 61


@pytest.mark.parametrize('record', [
    odometry('r2', 0), scan('r2', 0, [(1, (1.0, 0.0))]),
    robot_scan('r2', 0, [('r1', (1.0, 0.0))])])
def test_measurements_of_another_robot_are_not_written_to_the_own_log(record):
    settings = team('r1', 'r2')
    own = PeerSmoother(settings, 'r1', TeamLogs('r1', 1, settings.robots[0]), 10**9)

    assert own.add(record) is RejectionReason.UNKNOWN_ROBOT

    assert own.logs.contents('r1').measurements() == []
    assert own.observed.total() == own.used('r2') == 0


@pytest.mark.parametrize('stamp', [-1, -2**31 * 10**9, 2**31 * 10**9 - 1])
@pytest.mark.parametrize('record', [
    odometry('r1', 0), scan('r1', 0, [(1, (1.0, 0.0))]),
    robot_scan('r1', 0, [('r2', (1.0, 0.0))])])
def test_a_measurement_is_rejected_or_can_be_read_by_others(record, stamp):
    settings = team('r1', 'r2')
    own = PeerSmoother(settings, 'r1', TeamLogs('r1', 1, settings.robots[0]), 10**9)

    reason = own.add(replace(record, stamp=stamp))
    own.logs.flush()

    assert own.logs.contents('r1').measurements() == []
    assert reason is RejectionReason.BAD_STAMP
    assert own.statistics.received['r1'] == own.statistics.rejected['r1'] == 1
