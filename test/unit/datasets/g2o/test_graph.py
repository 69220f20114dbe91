# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The graph of a smoothing task, and its chi-square."""

import numpy as np
import pytest

from fej_slam_ros.datasets.g2o.graph import Edge, Graph, graph_of
from helpers.csam import smoothed
from helpers.records import team
from helpers.ros import meeting


def solved_graph(records, **changes):
    """Return the graph of records with noise, and the solution of the smoother."""
    smoother, _ = smoothed(records, team('r1', 'r2', max_delay=0.0, **changes))
    stamps = {name: trajectory.stamps for name, trajectory in smoother.trajectories.items()}
    return graph_of(smoother.task(), smoother.solution, stamps), smoother.solution


def disturbed(records):
    """Return records with an error in each observed position, which has a pattern and no mean."""
    for k, record in enumerate(records):
        for number, observation in enumerate(getattr(record, 'observations', ())):
            observation.z[:] += 0.05 * np.array([(-1) ** (k // 4 + number), (-1) ** (k // 8)])
    return records


def test_chi_square_is_the_sum_over_all_kinds_of_edges():
    graph = Graph(
        {4: np.zeros(3), 2: np.array([1.0, 0.0, np.pi / 2])}, {9: np.array([1.0, 3.0])},
        # Off by 0.5 m with 0.1 m, and by 0.1 rad with 0.2 rad.
        [Edge(4, 2, np.array([1.5, 0.0, np.pi / 2 + 0.1]), np.diag([0.01, 1.0, 0.04]))],
        # The landmark is 3 m ahead of the turned robot; off by 1 m with 0.5 m to the left.
        [Edge(2, 9, np.array([3.0, 1.0]), np.diag([1.0, 0.25]))],
        # Off by 2 m with 1 m.
        [Edge(4, 2, np.array([1.0, 2.0]), np.eye(2))])

    assert graph.chi_square() == pytest.approx(25.0 + 0.25 + 4.0 + 4.0, rel=1e-12)


def test_chi_square_of_joined_robots_is_that_of_the_smoother():
    graph, solution = solved_graph(disturbed(meeting(20)))

    solved, = solution.maps
    assert solved.chi_square > 1.0
    assert graph.chi_square() == pytest.approx(solved.chi_square, rel=1e-9)
    # 20 poses of each robot, at all of which but the first both saw all landmarks.
    landmarks = len(solved.points)
    assert [len(part) for part in (
        graph.poses, graph.points, graph.increments, graph.observations)] == [
            40, landmarks, 38, 38 * landmarks]
    assert graph.fixed == [0]
    assert {name.robot for name in graph.names.values()} == {'r1', 'r2'}


def test_maps_that_are_not_joined_have_vertices_of_their_own_for_the_same_landmarks():
    graph, solution = solved_graph(disturbed(meeting(20)), join_min_landmarks=100)

    assert len(solution.maps) == 2
    expected = sum(solved.chi_square for solved in solution.maps)
    assert graph.chi_square() == pytest.approx(expected, rel=1e-9)
    assert graph.fixed == [0, 20]
    assert sorted(graph.keys.values()) == sorted(2 * [*solution.maps[0].landmarks])
