# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Graph of a whole run: poses and landmarks as vertices, measurements as edges.

The cost is that of `least_squares`: the edges are its factors, with the covariance of each
measurement in the frame of the pose that it was taken from.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.csam.team_solution import (
    SmoothedMap, SmoothedTrajectory, SmoothingTask, TeamMap)
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.geometry import Array, starts_of
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing.factors import (
    Factors, LandmarkFactors, OdometryFactors, RendezvousFactors, Row, stacked, Values)
from fej_slam_ros.core.smoothing.least_squares import chi_square
from fej_slam_ros.core.smoothing.newest_pose import NearMarginal
from fej_slam_ros.core.smoothing.problem import Problem


class Edge(NamedTuple):
    """A measurement of one vertex from another."""

    begin: int  #: vertex of the pose that it was taken from
    end: int  #: vertex of the other pose, or of the landmark
    z: Array  #: (3,) or (2,) array, pose or position of `end` in the frame of `begin` [m, rad]
    R: Array  #: (3, 3) or (2, 2) array, its covariance in the same frame


class PoseName(NamedTuple):
    """Robot and stamp [ns] of a pose."""

    robot: str
    stamp: int


@dataclass(frozen=True, slots=True, eq=False)
class Graph:
    """Vertices, by their numbers, and edges."""

    #: poses, points: estimates of poses (3,) and landmarks (2,), as far as they are given
    poses: dict[int, Array] = field(default_factory=dict)
    points: dict[int, Array] = field(default_factory=dict)
    increments: list[Edge] = field(default_factory=list)  #: relative poses
    observations: list[Edge] = field(default_factory=list)  #: positions of landmarks
    robot_observations: list[Edge] = field(default_factory=list)  #: positions of other robots
    fixed: list[int] = field(default_factory=list)  #: poses that are not estimated
    #: names, keys: robot and stamp of each pose, and the keys of each landmark, where known
    names: dict[int, PoseName] = field(default_factory=dict)
    keys: dict[int, tuple[LandmarkKey, ...]] = field(default_factory=dict)

    def chi_square(self) -> float:
        """Return the sum of the squared normalised residuals; all vertices need an estimate."""
        pose = {vertex: index for index, vertex in enumerate(self.poses)}
        point = {vertex: index for index, vertex in enumerate(self.points)}

        def rows(edges: Iterable[Edge], end: Mapping[int, int]) -> Iterable[Row]:
            return ((pose[edge.begin], end[edge.end], edge.z, edge.R) for edge in edges)

        return chi_square(
            Problem(
                stacked(OdometryFactors, rows(self.increments, pose)),
                stacked(LandmarkFactors, rows(self.observations, point)),
                stacked(RendezvousFactors, rows(self.robot_observations, pose))),
            Values(
                np.array([*self.poses.values()]),
                np.array([*self.points.values()]).reshape(-1, 2)))


def graph_of(
    task: SmoothingTask, solution: TeamMap, stamps: Mapping[str, Sequence[int]]
) -> Graph:
    """
    Return the graph of a smoothing task, with the estimates of its solution.

    Poses are numbered robot by robot, landmarks after them, map by map. The first pose of the
    first robot of each map is fixed. Observations that the smoother removed as outliers are in the
    graph, robot-to-robot observations between maps are not.

    Parameters
    ----------
    task : measurements of all robots
    solution : a solution of the task; a robot without one keeps its own map
    stamps : of the poses [ns], by robot

    """
    maps = [*solution.maps, *(_unsolved(local) for local in task.maps if not any(
        local.robot in solved.trajectories for solved in solution.maps))]
    lengths = [len(local.values.poses) for local in task.maps]
    robots = [local.robot for local in task.maps]
    first = dict(zip(robots, starts_of(np.array(lengths)).tolist()))
    points = np.array([len(solved.points) for solved in maps])
    first_point = (sum(lengths) + starts_of(points)).tolist()
    graph = Graph(fixed=[first[next(iter(solved.trajectories))] for solved in maps])
    map_of = {robot: k for k, solved in enumerate(maps) for robot in solved.trajectories}
    for start, solved in zip(first_point, maps):
        graph.points.update(enumerate(solved.points, start))
        graph.keys.update(enumerate(solved.landmarks, start))
    for local in task.maps:
        robot, begin = local.robot, first[local.robot]
        trajectory = maps[map_of[robot]].trajectories[robot]
        vertices = (first_point[map_of[robot]] + trajectory.landmarks).tolist()
        graph.poses.update(enumerate(trajectory.poses, begin))
        graph.names.update(
            (begin + k, PoseName(robot, stamp)) for k, stamp in enumerate(stamps[robot]))
        graph.increments.extend(
            Edge(begin + k, begin + j, u, Q) for k, j, u, Q in _rows(local.problem.odometry))
        graph.observations.extend(
            Edge(begin + k, vertices[f], z, R) for k, f, z, R in _rows(local.problem.landmarks))
    graph.robot_observations.extend(
        Edge(first[m.observer] + m.pose, first[m.observed] + m.observed_pose, m.z, m.R)
        for m in task.measurements
        if m.observer in map_of and map_of[m.observer] == map_of.get(m.observed))
    return graph


def _unsolved(local: LocalMap) -> SmoothedMap:
    """Return the map of a robot whose measurements have no minimum, without covariances."""
    poses, points = local.values.poses, local.values.points
    trajectory = SmoothedTrajectory(
        poses, np.zeros((len(poses), 3, 3)), np.arange(len(points)),
        NearMarginal.of_pose(np.zeros((3, 3))))
    return SmoothedMap(
        own_frame(local.robot), {local.robot: trajectory}, {},
        tuple((key,) for key in local.landmarks), points, np.zeros((len(points), 2, 2)), 0.0, 0)


def _rows(factors: Factors) -> Iterable[Row]:
    return zip(factors.pose.tolist(), factors.target.tolist(), factors.z, factors.R)
