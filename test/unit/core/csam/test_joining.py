# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots that met end up with one map: the minimum of eq. (21) of [Andersson], or a reason."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.joining import join_maps, RendezvousMeasurement
from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import NS, Observation
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from helpers.core import turn, wrapped
from helpers.csam import in_another_frame, Met, true_base_node

CHAIN = [(a, a + 1, k) for a in (0, 1) for k in range(3, 8)]
LOOP = [*CHAIN, *((2, 0, k) for k in range(7, 11))]
PAIR = [(0, 1, k) for k in range(3, 8)]


def joined(team):
    """Return the one map that a team ends up with."""
    (joint,), failed = join_maps(team.maps, team.meetings)
    assert failed == []
    return joint


@pytest.mark.parametrize(('robots', 'met'), [
    (2, PAIR), (2, [(0, 1, 4), (1, 0, 4)]), (3, CHAIN), (3, LOOP)])
def test_the_joint_map_and_all_covariances_are_those_of_gtsam(robots, met):
    gtsam_reference = pytest.importorskip('helpers.gtsam_reference', reason='gtsam is not installed')
    joint = joined(Met(1, met, robots))

    reference = gtsam_reference.Reference(joint.problem, joint.values)

    gtsam_reference.assert_is_minimum(joint, reference)
    for robot, base_node in joint.base_nodes.items():
        # A robot's own frame is where it began.
        first = joint.first_poses[robot]
        assert_allclose(base_node.pose, reference.poses[first], atol=1e-8)
        expected = reference.covariance(gtsam_reference.pose_key(first))
        assert_allclose(base_node.P, expected, rtol=1e-8, atol=1e-8 * expected.max())


@pytest.mark.parametrize(('robots', 'met'), [(2, PAIR), (3, CHAIN), (3, LOOP)])
def test_what_was_measured_without_noise_becomes_the_true_map(robots, met):
    team = Met(2, met, robots, noise=0.0)

    joint = joined(team)

    assert joint.robots == ('r1', 'r2', 'r3')[:robots]
    for robot, base_node in joint.base_nodes.items():
        assert_allclose(base_node.pose, true_base_node(team, 'r1', robot), atol=1e-7)
    # All robots saw the same six landmarks.
    assert [len(keys) for keys in joint.landmarks] == 6 * [robots]
    assert len({frozenset(number for _, number in keys) for keys in joint.landmarks}) == 6
    assert joint.chi_square < 1e-6


def test_the_frame_is_that_of_the_first_robot_whoever_saw_whom():
    team = Met(3, [(1, 0, k) for k in range(3, 8)])

    joint = joined(team)

    assert joint.robots[0] == 'r1'
    assert_allclose(joint.values.poses[0], 0.0)


def test_a_map_in_another_frame_has_another_base_node_and_nothing_else():
    team = Met(4, PAIR)
    frame = np.array([300.0, -200.0, 2.5])
    moved = [team.maps[0], in_another_frame(team.maps[1], frame)]

    (joint,), _ = join_maps(moved, team.meetings)

    expected = joined(team)
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)
    assert joint.landmarks == expected.landmarks
    first = joint.values.poses[joint.first_poses['r2']]
    x, y, phi = joint.base_nodes['r2'].pose
    # The base node takes pose 0, which is at `frame` there, to where it is in the joint map.
    c, s = np.cos(phi), np.sin(phi)
    taken = [x + c * frame[0] - s * frame[1], y + s * frame[0] + c * frame[1]]
    assert_allclose(taken, first[:2], atol=1e-8)
    assert wrapped(phi + frame[2] - first[2]) == pytest.approx(0.0, abs=1e-9)


def test_two_landmarks_of_one_place_and_one_robot_are_told_apart_by_whose_they_are():
    joint = joined(Met(5, PAIR))

    for keys in joint.landmarks:
        assert sorted(owner for owner, _ in keys) == ['r1', 'r2']


def reasons(team):
    """Return the maps that a team ends up with, and why some are apart."""
    groups, failed = join_maps(team.maps, team.meetings)
    return [group.robots for group in groups], failed


def test_robots_that_never_met_keep_their_maps():
    team = Met(6, [])

    groups, failed = join_maps(team.maps, [])

    assert [group.robots for group in groups] == [('r1',), ('r2',)]
    assert failed == []
    for group, local in zip(groups, team.maps):
        assert_allclose(group.values.poses, local.values.poses, atol=1e-8)
        assert group.base_nodes == {}


def test_one_observation_leaves_the_maps_as_they_are_and_says_why():
    groups, failed = reasons(Met(7, [(0, 1, 4)]))

    assert groups == [('r1',), ('r2',)]
    assert failed == [JoinFailure(
        'not enough observations: 1 of the 2 that are needed', ('r1', 'r2'))]


def test_a_wrong_meeting_leaves_the_maps_as_they_are_and_says_why():
    team = Met(8, PAIR)
    team.meetings[0] = replace(team.meetings[0], z=team.meetings[0].z + np.array([0.6, 0.0]))

    groups, failed = reasons(team)

    assert groups == [('r1',), ('r2',)]
    assert failed[0].reason.startswith('inconsistent (chi-square')


def test_a_wrong_meeting_that_closes_a_loop_is_left_out():
    team = Met(9, LOOP, robots=3)
    wrong = [
        replace(met, z=met.z + np.array([2.0, 2.0])) if met.observer == 'r3' else met
        for met in team.meetings]

    (joint,), failed = join_maps(team.maps, wrong)

    assert [failure.robots for failure in failed] == [('r1', 'r3')]
    assert failed[0].reason.startswith('inconsistent (chi-square')
    (without,), _ = join_maps(team.maps, team.meetings[:len(CHAIN)])
    assert_allclose(joint.values.poses, without.values.poses, atol=1e-8)


def test_a_observation_too_few_counts_once_others_have_joined_the_robots():
    met = [*CHAIN, (2, 0, 9)]
    team = Met(10, met, robots=3)

    joint = joined(team)

    assert len(joint.problem.rendezvous.z) == len(met)


def test_shared_landmarks_join_robots_that_never_met():
    team = Met(11, [], shared=True)

    joint = joined(team)

    assert joint.robots == ('r1', 'r2')
    assert list(joint.landmarks) == [(('', number),) for number in range(6)]
    error = joint.base_nodes['r2'].pose - true_base_node(team, 'r1', 'r2')
    error[2] = wrapped(error[2])
    # chi-square of 3 degrees of freedom is below 16.3 with probability 0.999.
    assert error @ np.linalg.solve(joint.base_nodes['r2'].P, error) < 16.3


def test_too_few_shared_landmarks_join_nobody_and_say_why():
    team = Met(12, [], landmarks=2, shared=True)

    groups, failed = reasons(team)

    assert groups == [('r1',), ('r2',)]
    assert failed[0].reason == '2 shared landmarks, 3 are needed'


def test_where_shared_landmarks_tell_no_heading_a_meeting_does():
    heap = np.array([[2.0, 1.0], [2.01, 1.0], [2.0, 1.01]])
    starts, maps, ways = {'r1': np.zeros(3), 'r2': np.array([1.0, -1.0, 0.5])}, [], {}
    for name, start in starts.items():
        ways[name] = start + np.outer(np.arange(8), [0.3, 0.1, 0.1])
        scans = [
            [Observation(i, turn(x[2]).T @ (point - x[:2]), 0.01 * np.eye(2))
             for i, point in enumerate(heap)] for x in ways[name]]
        smoother = IncrementalSmoother(scans[0])
        for a, b, scan in zip(ways[name], ways[name][1:], scans[1:]):
            u = np.array([*(turn(a[2]).T @ (b - a)[:2]), b[2] - a[2]])
            smoother.add(u, 1e-4 * np.eye(3), scan)
        maps.append(LocalMap(
            name, smoother.problem(), smoother.values(), (('', 0), ('', 1), ('', 2))))
    meetings = [
        RendezvousMeasurement('r1', k, 'r2', k, turn(x[2]).T @ (y - x)[:2], 1e-4 * np.eye(2), k * NS)
        for k, (x, y) in enumerate(zip(*ways.values()))]

    (_, by_landmarks), (by_meeting,) = join_maps(maps, [])[0], join_maps(maps, meetings)[0]

    assert by_landmarks.robots == ('r2',)
    assert_allclose(by_meeting.base_nodes['r2'].pose, starts['r2'], atol=1e-8)
    assert len(by_meeting.landmarks) == 3


def test_a_second_meeting_of_two_robots_closes_a_loop():
    first = [(0, 1, k) for k in range(3, 8)]
    met = [*first, *((0, 1, k) for k in range(40, 45))]
    team = Met(13, met, steps=50)

    joint = joined(team)

    assert len(joint.problem.rendezvous.z) == len(met)
    (once,), _ = join_maps(team.maps, team.meetings[:len(first)])
    assert joint.base_nodes['r2'].P[2, 2] < once.base_nodes['r2'].P[2, 2]


def test_a_wrong_second_meeting_is_left_out_and_the_first_one_counts():
    met = [(0, 1, k) for k in (*range(3, 8), *range(40, 45))]
    team = Met(14, met, steps=50)
    wrong = [
        replace(seen, z=seen.z + np.array([1.0, 0.0])) if seen.pose == 41 else seen
        for seen in team.meetings]

    (joint,), failed = join_maps(team.maps, wrong)

    assert len(joint.problem.rendezvous.z) == 5
    assert [failure.robots for failure in failed] == [('r1', 'r2')]


def test_observations_that_are_too_few_each_time_do_together():
    met = [(0, 1, 3), (0, 1, 28)]

    assert len(joined(Met(15, met, steps=30)).problem.rendezvous.z) == 2


@pytest.mark.parametrize('wrong', [[7], [0, 30]])
def test_a_few_wrong_observations_of_a_long_meeting_are_left_out_and_told(wrong):
    met = [(0, 1, k) for k in range(3, 43)]
    team = Met(20, met, steps=45)
    told = [
        replace(seen, z=seen.z + np.array([0.0, 1.5])) if k in wrong else seen
        for k, seen in enumerate(team.meetings)]

    (joint,), notes = join_maps(team.maps, told)

    assert notes == [JoinFailure(
        f'{len(wrong)} of 40 observations contradict the rest', ('r1', 'r2'))]
    right = [seen for k, seen in enumerate(team.meetings) if k not in wrong]
    (expected,), _ = join_maps(team.maps, right)
    assert_allclose(joint.values.poses, expected.values.poses, atol=1e-8)


def test_of_few_observations_nobody_can_tell_which_is_wrong():
    team = Met(21, PAIR)
    told = [replace(team.meetings[0], z=team.meetings[0].z + 1.0), *team.meetings[1:]]

    groups, failed = join_maps(team.maps, told)

    assert len(groups) == 2
    assert len(failed) == 1
