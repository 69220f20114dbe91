# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Alignment by a few kB: where the other robot is, before any of its map arrives."""

from dataclasses import replace
from functools import cache

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.base_node import RendezvousInformation
from fej_slam_ros.core.geometry import between, compose, inverse, rotation
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.peers.blocks import BadBlockError
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.rendezvous_window import (
    read, rendezvous_task, solve_rendezvous, WindowInformation, write)
from fej_slam_ros.core.records import NS, Odometry, RobotObservation, RobotScan, TruePose
from fej_slam_ros.sim.environments import RENDEZVOUS_ENVIRONMENTS
from helpers.core import pose_difference
from helpers.radio import is_measurement, Robot, team_settings


@cache
def measured(experiment, seed):
    return [*RENDEZVOUS_ENVIRONMENTS[experiment].records(np.random.default_rng(seed))]


def met(experiment, seed=3, change=lambda record: record):
    """Return two robots with the measurements of an experiment, and their true starts."""
    records = measured(experiment, seed)
    settings = team_settings(['p', 'q'], shared=False)
    robots = {name: Robot(name, settings) for name in 'pq'}
    for record in filter(is_measurement, records):
        robots[record.robot].logs.record(change(record))
    poses = {}
    for record in records:
        if isinstance(record, TruePose):
            poses.setdefault(record.robot, []).append(record.pose)
    return robots, poses


def give(robots, sender, receiver):
    """Give a robot the information of another, as the exchange does; return its size."""
    name = LogName(sender, receiver)
    log = robots[sender].logs.logs[name]
    for number in range(len(log.blocks)):
        robots[receiver].logs.add(log.block(number))
    return sum(map(len, log.blocks))


@pytest.mark.parametrize('experiment', ['map_joining', 'sensor_extension'])
def test_both_robots_are_aligned_after_less_than_ten_kilobytes(experiment):
    robots, true = met(experiment)
    # In one experiment only p observes; q has information once it has received these.
    for sender, receiver in ('pq', 'qp', 'pq'):
        if robots[sender].share_rendezvous(receiver) is not None:
            size = give(robots, sender, receiver)
            assert size < 5_000

    of_p, of_q = (robots[one].share_rendezvous(other) for one, other in ('pq', 'qp'))

    for own, other, result in (('p', 'q', of_p), ('q', 'p', of_q)):
        base, P = result.alignment.base_node.pose, result.alignment.base_node.P
        error = pose_difference(base, between(true[own][0], true[other][0]))
        # Three sigmas of a pose are 3.8 of a vector of three.
        assert error @ np.linalg.solve(P, error) < 3.8**2
    # Both have the same information, in single precision, and linearise at other poses.
    assert_allclose(
        of_p.alignment.base_node.pose, inverse(of_q.alignment.base_node.pose), atol=0.05)


def with_errors(error, scans):
    """Return a change of the measurements, by an error [m] of p's observations in some scans."""
    count = iter(range(1_000_000))

    def changed(record):
        if record.robot != 'p' or not isinstance(record, RobotScan) or not record.observations:
            return record
        shift = np.array(error) if next(count) in scans else np.zeros(2)
        return replace(record, observations=tuple(
            replace(o, z=o.z + shift) for o in record.observations))

    return changed


# From 5 m on, the iteration does not converge with the wrong one.
@pytest.mark.parametrize('error', [(2.0, 0.0), (0.0, 5.0), (-20.0, 5.0), (100.0, 0.0)])
@pytest.mark.parametrize(('scans', 'is_aligned'), [([2], True), ([2, 5], False)])
def test_one_observation_of_the_sixteen_of_both_robots_may_be_wrong(error, scans, is_aligned):
    robots, true = met('map_joining', change=with_errors(error, scans))
    robots['q'].share_rendezvous('p')
    give(robots, 'q', 'p')

    alignment = robots['p'].share_rendezvous('q').alignment

    assert isinstance(alignment, JoinFailure) != is_aligned
    if is_aligned:
        base, P = alignment.base_node.pose, alignment.base_node.P
        deviation = pose_difference(base, between(true['p'][0], true['q'][0]))
        # Three sigmas of a pose are 3.8 of a vector of three.
        assert deviation @ np.linalg.solve(P, deviation) < 3.8**2


def distorted(record):
    """Return observations of q by a sensor with a bearing bias of 0.3 rad and a range scale."""
    if record.robot != 'q' or isinstance(record, Odometry):
        return record
    A, scale = rotation(0.3) / 0.9, 2.0 if isinstance(record, RobotScan) else 1.0
    return replace(record, observations=tuple(
        replace(o, z=A @ o.z, R=A @ o.R @ A.T / scale**2) for o in record.observations))


def test_observations_are_corrected_by_the_parameters_of_their_own_robot():
    """Here q, whose parameters p does not know before it has the log of q."""
    robots, _ = met('map_joining')
    wrong, _ = met('map_joining', change=distorted)
    wrong['q'].settings = replace(wrong['q'].settings, robots=tuple(
        replace(robot, observation_bearing_bias=0.3, observation_range_scale=0.9,
                robot_noise_scale=2.0) if robot.name == 'q' else robot
        for robot in wrong['q'].settings.robots))

    for case in (robots, wrong):
        case['q'].share_rendezvous('p')
        give(case, 'q', 'p')
    results = [case['p'].share_rendezvous('q') for case in (robots, wrong)]
    expected, base = (result.alignment.base_node for result in results)

    # R_sqrt of the information has single precision.
    assert_allclose(base.pose, expected.pose, atol=1e-5)
    assert_allclose(base.P, expected.P, atol=1e-5)


def test_the_pose_of_the_other_robot_is_where_it_was_last_seen():
    robots, true = met('map_joining')
    robots['q'].share_rendezvous('p')
    give(robots, 'q', 'p')

    result = robots['p'].share_rendezvous('q')

    step = round(result.stamp / 0.5e9)
    in_p = between(true['p'][0], true['q'][step])
    assert_allclose(result.pose[:2], in_p[:2], atol=0.5)


def test_without_a_rendezvous_there_is_no_information():
    robots, _ = met('map_joining', change=lambda record: (
        replace(record, observations=()) if isinstance(record, RobotScan) else record))

    assert robots['p'].share_rendezvous('q') is None


@pytest.mark.parametrize(('size', 'reason'), [
    (0.2, 'inconsistent (chi-square'), (20.0, 'cannot align: the iteration did not converge')])
def test_a_rendezvous_that_contradicts_the_maps_is_rejected_with_the_reason(size, reason):
    rng = np.random.default_rng(0)

    def displaced(record):
        if record.robot != 'p' or not isinstance(record, RobotScan):
            return record
        return replace(record, observations=tuple(
            replace(o, z=o.z + rng.uniform(-size, size, 2)) for o in record.observations))

    robots, _ = met('map_joining', change=displaced)
    robots['q'].share_rendezvous('p')
    give(robots, 'q', 'p')

    failure = robots['p'].share_rendezvous('q').alignment

    assert isinstance(failure, JoinFailure)
    assert reason in failure.reason


def test_information_is_read_as_it_was_written_and_a_part_of_it_is_rejected():
    robots, _ = met('map_joining')
    robots['p'].share_rendezvous('q')
    message = b''.join(robots['p'].logs.logs[LogName('p', 'q')].blocks)

    window = read(message, 'p', 'q')

    assert write(window) == message
    for size in range(1, len(message)):
        with pytest.raises(BadBlockError):
            read(message[:size], 'p', 'q')


def test_a_scan_may_observe_the_other_robot_more_than_once():
    def twice(record):
        return record if not isinstance(record, RobotScan) else replace(
            record, observations=record.observations * 2)

    robots, _ = met('map_joining', change=twice)
    robots['p'].share_rendezvous('q')

    window = read(b''.join(robots['p'].logs.logs[LogName('p', 'q')].blocks), 'p', 'q')

    assert window.scans
    assert all(len(scan.observations) == 2 for scan in window.scans)


@pytest.mark.parametrize('poses', [17, 18])
def test_information_has_at_most_eight_observations_of_each_robot_and_the_start(poses):
    information = RendezvousInformation(
        np.zeros((poses, 3)), 0, 0, np.zeros(3), np.eye(3 * poses - 3))
    message = write(WindowInformation(tuple(range(poses)), information, ()))

    if poses == 17:
        assert read(message, 'p', 'q').stamps == (*range(17),)
    else:
        with pytest.raises(BadBlockError):
            read(message, 'p', 'q')


def test_information_with_numbers_that_are_not_finite_is_taken_for_none():
    robots, _ = met('map_joining')
    robots['p'].share_rendezvous('q')
    window = read(b''.join(robots['p'].logs.logs[LogName('p', 'q')].blocks), 'p', 'q')
    bad = write(replace(window, information=replace(
        window.information, R_sqrt=np.nan * window.information.R_sqrt)))

    task = replace(
        rendezvous_task(robots['q'].logs, robots['q'].settings, 'p'), received=bad)

    assert 'has sent no rendezvous information' in solve_rendezvous(task).alignment.reason


def test_poses_in_the_map_do_not_depend_on_the_frame_of_the_information():
    robots, _ = met('map_joining')
    robots['p'].share_rendezvous('q')
    window = read(b''.join(robots['p'].logs.logs[LogName('p', 'q')].blocks), 'p', 'q')

    # Row by row, the poses relative to the first of them.
    stored = [between(window.information.poses[0], pose) for pose in window.information.poses]
    in_map = [window.information.in_map(row) for row in range(len(window.stamps))]

    assert_allclose([compose(in_map[0], pose) for pose in stored], in_map, atol=1e-12)


def test_a_robot_without_odometry_has_no_information():
    robots, _ = met('map_joining')
    robots['q'].share_rendezvous('p')
    parked = Robot('p', robots['p'].settings)
    give({'p': parked, 'q': robots['q']}, 'q', 'p')

    assert parked.share_rendezvous('q') is None


def test_robots_that_observe_each_other_only_at_their_start_are_aligned():
    """The information of each is one pose, which its map fixes: there is no R_sqrt."""
    settings = team_settings(['p', 'q'], shared=False)
    robots = {name: Robot(name, settings) for name in 'pq'}
    # q starts 2 m ahead of p and 1 m to its left, turned to the left by 90 deg.
    for name, other, z in ('p', 'q', (2.0, 1.0)), ('q', 'p', (-1.0, 2.0)):
        logs = robots[name].logs
        logs.record(Odometry(name, 0, np.zeros(3), None))
        logs.record(RobotScan(name, 0, (
            RobotObservation(other, np.array(z), 1e-4 * np.eye(2)),)))
        logs.record(Odometry(name, NS, np.array([1.0, 0.0, 0.0]), 1e-4 * np.eye(3)))
    assert isinstance(robots['p'].share_rendezvous('q').alignment, JoinFailure)
    give(robots, 'p', 'q')

    alignment = robots['q'].share_rendezvous('p').alignment

    # Observations without errors.
    assert_allclose(alignment.base_node.pose, [-1.0, 2.0, -np.pi / 2.0], atol=1e-9)


def window_of(odometry, seen, **changes):
    """Return the information of p with odometry and observations of q at times in seconds."""
    robot = Robot('p', replace(team_settings(['p', 'q'], shared=False), **changes))
    for second in odometry:
        robot.logs.record(
            Odometry('p', second * NS, np.array([second, 0.0, 0.0]), 1e-4 * np.eye(3)))
    observation = RobotObservation('q', np.array([2.0, 1.0]), 1e-4 * np.eye(2))
    for second in seen:
        robot.logs.record(RobotScan('p', second * NS, (observation,)))
    robot.share_rendezvous('q')
    return read(b''.join(robot.logs.logs[LogName('p', 'q')].blocks), 'p', 'q')


@pytest.mark.parametrize(('odometry', 'seen', 'sent'), [
    pytest.param(range(60), [5, 6, 40, 41], [40, 41], id='the last rendezvous'),
    pytest.param(range(10), [5, 30], [5], id='up to the newest odometry'),
    pytest.param(range(3, 10), [1, 5], [5], id='from the first odometry'),
    pytest.param(range(10), range(10), [0, 1, 3, 4, 5, 6, 8, 9], id='eight spread over it')])
def test_observations_of_the_last_rendezvous_at_known_poses_are_sent(odometry, seen, sent):
    window = window_of(odometry, seen)

    assert [scan.stamp // NS for scan in window.scans] == sent
    assert {*window.stamps} >= {scan.stamp for scan in window.scans}


def test_poses_of_a_rendezvous_are_in_the_information_however_seldom_keyframes_are():
    window = window_of(range(10), [2, 4, 6], keyframe_distance=100.0)

    assert {stamp // NS for stamp in window.stamps} >= {2, 4, 6}


@pytest.mark.parametrize(('middle', 'start'), [(2, 0), (0, 2)])
def test_information_about_a_pose_that_it_does_not_have_is_rejected(middle, start):
    information = RendezvousInformation(
        np.zeros((2, 3)), middle, start, np.zeros(3), np.eye(3))
    message = write(WindowInformation((0, 1), information, ()))

    with pytest.raises(BadBlockError):
        read(message, 'p', 'q')


@pytest.mark.parametrize('count', [8, 9])
def test_information_has_at_most_eight_observations(count):
    scan = RobotScan('p', 0, (RobotObservation('q', np.ones(2), np.eye(2)),))
    information = RendezvousInformation(np.zeros((1, 3)), 0, 0, np.zeros(3), np.empty((0, 0)))
    message = write(WindowInformation((0,), information, (scan,) * count))

    if count == 8:
        assert len(read(message, 'p', 'q').scans) == 8
    else:
        with pytest.raises(BadBlockError, match='too many observations'):
            read(message, 'p', 'q')
