# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectories of robots in graphs without names, and the records of their edges."""

from collections import Counter

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.ordering.odometry_increments import increment
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from fej_slam_ros.core.settings import NoiseSettings
from fej_slam_ros.datasets.g2o import conversion
from fej_slam_ros.datasets.g2o.graph import Edge, Graph, PoseName
from fej_slam_ros.errors import UserError

PERIOD = 250_000_000
Q = np.diag([0.01, 0.04, 0.0025])


def step(begin, end, u=(1.0, 0.5, 0.3)):
    return Edge(begin, end, np.array(u), Q)


def sighting(pose, vertex):
    return Edge(pose, vertex, np.array([2.0, 1.0]), 0.01 * np.eye(2))


def converted(graph):
    unused = Counter()
    robots = conversion.trajectories(graph, PERIOD)
    return robots, conversion.records(graph, robots, unused), +unused


def test_odometry_between_the_poses_is_that_of_the_edges():
    us = [(1.0, 0.5, 2.0), (0.5, -0.2, 2.0), (0.1, 0.0, -3.0)]

    _, records, _ = converted(Graph(increments=[
        step(k, k + 1, u) for k, u in enumerate(us)]))

    assert [r.stamp for r in records] == [conversion.LOG_START + k * PERIOD for k in range(4)]
    for u, earlier, later in zip(us, records, records[1:]):
        got, covariance = increment(earlier, later, NoiseSettings())
        assert_allclose(got, u, atol=1e-14)
        assert_allclose(covariance, Q, rtol=1e-14)


def test_chains_of_poses_are_robots_even_if_their_numbers_alternate():
    robots, _, unused = converted(Graph(increments=[
        step(0, 2), step(1, 3), step(2, 4), step(3, 5), step(0, 4)]))

    assert robots.poses == {'r1': [0, 2, 4], 'r2': [1, 3, 5]}
    assert unused == {'relative pose beside the trajectories': 1}


def test_of_two_relative_poses_of_the_same_poses_the_first_is_the_odometry():
    robots, _, unused = converted(Graph(increments=[
        step(0, 1), step(1, 2), step(0, 1, (9, 9, 1))]))

    assert_allclose(robots.increments['r1'][0].z, step(0, 1).z)
    assert unused == {'relative pose beside the trajectories': 1}


def test_an_observation_that_is_there_twice_is_used_once():
    other = Edge(1, 2, np.array([2.1, 1.0]), 0.01 * np.eye(2))

    _, records, unused = converted(Graph(
        increments=[step(0, 1)], observations=[sighting(1, 2), other, sighting(1, 2)]))

    seen = [s.z.tolist() for r in records if isinstance(r, Scan) for s in r.observations]
    assert sorted(seen) == [[2.0, 1.0], [2.1, 1.0]]
    assert unused == {'observation repeated': 1}


def test_numbers_of_landmarks_may_lie_between_those_of_poses():
    robots, records, _ = converted(Graph(
        increments=[step(0, 1), step(1, 3)], observations=[sighting(1, 2), sighting(3, 2)]))

    assert robots.poses == {'r1': [0, 1, 3]}
    assert [(r.stamp, [o.id for o in r.observations]) for r in records if isinstance(r, Scan)] == [
        (conversion.LOG_START + k * PERIOD, [2]) for k in (1, 2)]


def test_landmarks_with_symbols_of_gtsam_are_numbered():
    first = ord('l') << 56

    _, records, _ = converted(Graph(
        increments=[step(0, 1)], observations=[sighting(1, first + 8), sighting(1, first + 3)]))

    assert [o.id for o in records[-1].observations] == [1, 0]


def test_landmarks_with_numbers_that_are_no_ids_are_numbered():
    _, records, _ = converted(Graph(
        increments=[step(0, 1)], observations=[sighting(1, -1), sighting(1, -7)]))

    assert [o.id for o in records[-1].observations] == [1, 0]


@pytest.mark.parametrize('keys', [{5: (('', 1),)}, {4: (('b', 1),)}])
def test_an_observation_of_a_landmark_without_id_in_a_named_graph_is_an_error(keys):
    with pytest.raises(UserError, match='landmark 4, which a observes, has no ID for it'):
        converted(Graph(
            increments=[step(0, 1)], observations=[sighting(1, 4)],
            names={0: PoseName('a', 5), 1: PoseName('a', 9)}, keys=keys))


def test_names_in_a_graph_give_robots_stamps_and_ids():
    graph = Graph(
        increments=[step(0, 1), step(2, 3)], observations=[sighting(1, 4), sighting(3, 4)],
        robot_observations=[sighting(1, 3), sighting(0, 3)],
        names={0: PoseName('a', 5), 1: PoseName('a', 9), 2: PoseName('b', 7), 3: PoseName('b', 9)},
        keys={4: (('a', 11), ('b', 12))})

    robots, records, unused = converted(graph)

    assert [(r.robot, r.stamp) for r in records if isinstance(r, Odometry)] == [
        ('a', 5), ('b', 7), ('a', 9), ('b', 9)]
    assert {r.robot: r.observations[0].id for r in records if isinstance(r, Scan)} == {
        'a': 11, 'b': 12}
    met, = [r for r in records if isinstance(r, RobotScan)]
    assert (met.robot, met.stamp, met.observations[0].observed) == ('a', 9, 'b')
    assert unused == {'observation of a robot at another stamp': 1}
    assert not conversion.settings(graph, robots).shared_landmark_ids


def test_the_anchor_starts_at_the_estimate_of_its_first_pose():
    graph = Graph(
        {2: np.array([1.0, 2.0, 3.0])}, increments=[step(0, 1), step(2, 3)], fixed=[2])

    settings = conversion.settings(graph, conversion.trajectories(graph, PERIOD))

    assert (settings.anchor, settings.anchor_pose) == ('r2', (1.0, 2.0, 3.0))
    assert [robot.start_pose for robot in settings.robots] == [None, None]


@pytest.mark.parametrize('graph', [
    pytest.param(Graph(observations=[sighting(0, 1)]), id='landmarks only'),
    pytest.param(Graph(increments=[step(2, 1), step(1, 0)]), id='back to lower numbers')])
def test_a_graph_without_odometry_is_an_error_that_says_what_odometry_is(graph):
    with pytest.raises(UserError, match=r'no odometry: .* to one with a higher number'):
        conversion.trajectories(graph, PERIOD)


def test_a_missing_increment_of_a_named_robot_is_an_error():
    names = {k: PoseName('a', k) for k in range(3)}

    with pytest.raises(UserError, match='poses 1 and 2 of a follow each other without'):
        conversion.trajectories(Graph(increments=[step(0, 1)], names=names), PERIOD)


def test_two_poses_of_a_robot_at_one_stamp_are_an_error():
    names = {0: PoseName('a', 7), 1: PoseName('a', 7)}

    with pytest.raises(UserError, match='two poses of a have one stamp'):
        conversion.trajectories(Graph(increments=[step(0, 1)], names=names), PERIOD)


def test_the_id_that_a_robot_has_for_a_landmark_counts_before_that_of_all_robots():
    _, records, _ = converted(Graph(
        increments=[step(0, 1), step(2, 3)], observations=[sighting(1, 4), sighting(3, 4)],
        names={0: PoseName('a', 5), 1: PoseName('a', 9), 2: PoseName('b', 7), 3: PoseName('b', 9)},
        keys={4: (('', 11), ('b', 12))}))

    assert {r.robot: r.observations[0].id for r in records if isinstance(r, Scan)} == {
        'a': 11, 'b': 12}
