# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Records of a graph: the trajectories of robots, and what was observed from their poses.

A graph that `export g2o` has written names robots, stamps and landmark IDs. In others a trajectory
is a chain of poses, each connected to the nearest later one by its number; its poses have a fixed
period. Relative poses beside the chains, such as loop closures, have no record.
"""

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter

import numpy as np

from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.ordering.impossible_motion import UNLIMITED
from fej_slam_ros.core.records import (
    MAX_ID, NS, Observation, Odometry, Record, RobotObservation, RobotScan, Scan)
from fej_slam_ros.core.settings import ORIGIN, RobotSettings, Settings
from fej_slam_ros.datasets.g2o.graph import Edge, Graph, PoseName
from fej_slam_ros.datasets.scans import distinct, divided
from fej_slam_ros.errors import UserError

#: Stamp of the first pose of each robot without stamps [ns].
LOG_START = NS


@dataclass(frozen=True, slots=True, eq=False)
class Trajectories:
    """Trajectories of the robots of a graph."""

    #: vertices of the poses of each robot, in the order of time, and their increments
    poses: Mapping[str, Sequence[int]]
    increments: Mapping[str, Sequence[Edge]]
    names: Mapping[int, PoseName]  #: robot and stamp of each pose
    unused: int  #: number of relative poses that are no part of a trajectory


def trajectories(graph: Graph, period: int) -> Trajectories:
    """
    Return the trajectories in a graph.

    Parameters
    ----------
    period : time between two poses of a robot [ns], where the graph has no stamps

    Raises
    ------
    UserError
        The graph has no trajectory, or one with a missing increment.

    """
    names = graph.names or _numbered(graph, period)
    poses = by_robot(names)
    # Odometry is written first; other relative poses of the same two are of other sensors.
    edges = {(edge.begin, edge.end): edge for edge in reversed(graph.increments)}
    increments = {}
    for robot, vertices in poses.items():
        missing = [pair for pair in pairwise(vertices) if pair not in edges]
        if missing:
            raise UserError(
                'poses {} and {} of {} follow each other without an EDGE_SE2 between them: export'
                ' the bag again'.format(*missing[0], robot))
        if len({names[vertex].stamp for vertex in vertices}) < len(vertices):
            raise UserError(f'two poses of {robot} have one stamp: export the bag again')
        increments[robot] = [edges[pair] for pair in pairwise(vertices)]
    if not any(increments.values()):
        raise UserError(
            'it has no odometry: relative poses in the plane are needed, each from a pose to one'
            ' with a higher number')
    used = sum(map(len, increments.values()))
    return Trajectories(poses, increments, names, len(graph.increments) - used)


def by_robot(names: Mapping[int, PoseName]) -> dict[str, list[int]]:
    """Return the vertices of each robot in the order of stamps; the first robot has ID 1."""
    poses: dict[str, list[int]] = defaultdict(list)
    for vertex in sorted(names, key=lambda vertex: (names[vertex].stamp, vertex)):
        poses[names[vertex].robot].append(vertex)
    return poses


def records(graph: Graph, robots: Trajectories, unused: Counter[str]) -> list[Record]:
    """Return odometry and scans in the order of stamps; count what has no record by its reason."""
    unused['relative pose beside the trajectories'] += robots.unused
    unused['FIX of no pose of a robot'] += sum(v not in robots.names for v in graph.fixed)
    result: list[Record] = []
    for robot in robots.poses:
        result += _odometry(robot, robots)
    landmarks = _observations(graph, robots, unused)
    result += (
        Scan(*robots.names[k], scan) for k, seen in landmarks.items() for scan in divided(seen))
    others = _robot_observations(graph, robots, unused)
    result += (
        RobotScan(*robots.names[k], scan) for k, seen in others.items() for scan in divided(seen))
    return sorted(result, key=attrgetter('stamp'))


def _observations(
    graph: Graph, robots: Trajectories, unused: Counter[str]
) -> Mapping[int, Sequence[Observation]]:
    """Return the observations of landmarks by the vertex of the pose; count the others."""
    ids = _landmark_ids(graph)
    landmarks: dict[int, list[Observation]] = defaultdict(list)
    for edge in graph.observations:
        if edge.begin in robots.names:
            landmark = _id_of(ids, edge.end, robots.names[edge.begin].robot)
            landmarks[edge.begin].append(Observation(landmark, edge.z, edge.R))
        else:
            unused['observation from a pose without odometry'] += 1
    kept = {pose: distinct(seen) for pose, seen in landmarks.items()}
    unused['observation repeated'] += sum(
        len(seen) - len(kept[pose]) for pose, seen in landmarks.items())
    return kept


def _robot_observations(
    graph: Graph, robots: Trajectories, unused: Counter[str]
) -> Mapping[int, Sequence[RobotObservation]]:
    """Return the observations of robots by the vertex of the pose; count the others."""
    others: dict[int, list[RobotObservation]] = defaultdict(list)
    for edge in graph.robot_observations:
        observer, observed = (robots.names.get(vertex) for vertex in (edge.begin, edge.end))
        if observer and observed and observer.stamp == observed.stamp:
            others[edge.begin].append(RobotObservation(observed.robot, edge.z, edge.R))
        else:
            unused['observation of a robot at another stamp'] += 1
    return others


def settings(graph: Graph, robots: Trajectories) -> Settings:
    """
    Return the settings of a run in which the robots map together; the graph has all noise.

    The first robot with a fixed pose, else the first one, is the anchor. The measurements of a
    graph are accepted ones, so the gate is off, and motions are not checked.
    """
    fixed = [robots.names[vertex].robot for vertex in graph.fixed if vertex in robots.names]
    anchor = [*fixed, *robots.poses][0]
    first = robots.poses[anchor][0]
    x, y, phi = graph.poses[first].tolist() if first in graph.poses else ORIGIN
    return Settings(
        tuple(
            RobotSettings(name, id_, max_speed=UNLIMITED)
            for id_, name in enumerate(robots.poses, start=1)),
        anchor=anchor, anchor_pose=(x, y, phi), gate_probability=1.0,
        shared_landmark_ids=not any(robot for keys in graph.keys.values() for robot, _ in keys))


def _odometry(robot: str, robots: Trajectories) -> Iterator[Odometry]:
    """Yield integrated odometry, whose increments are the edges."""
    first, *later = robots.poses[robot]
    pose, before = np.zeros(3), robots.names[first].stamp
    yield Odometry(robot, before, pose, None)
    for vertex, edge in zip(later, robots.increments[robot]):
        pose, stamp = compose(pose, edge.z), robots.names[vertex].stamp
        dt, before = (stamp - before) / NS, stamp
        yield Odometry(robot, stamp, pose, edge.R / dt ** 2)


def _id_of(ids: Mapping[int, Mapping[str, int]], vertex: int, robot: str) -> int:
    """Return the ID of a landmark for a robot; raise a `UserError` if it has none."""
    names = ids.get(vertex, {})
    if not names.keys() & {robot, ''}:
        raise UserError(
            f'landmark {vertex}, which {robot} observes, has no ID for it in the comments'
            ' "# fej_slam LANDMARK": add one, or remove all these comments')
    return names[robot] if robot in names else names['']


def _landmark_ids(graph: Graph) -> dict[int, dict[str, int]]:
    """Return the IDs of each landmark by robot, '' for all robots."""
    if graph.keys:
        return {vertex: dict(keys) for vertex, keys in graph.keys.items()}
    vertices = sorted({edge.end for edge in graph.observations})
    # The numbers of GTSAM contain a letter, and are beyond the IDs of a bag.
    are_ids = bool(vertices) and vertices[0] >= 0 and vertices[-1] <= MAX_ID
    numbers = vertices if are_ids else range(len(vertices))
    return {vertex: {'': number} for vertex, number in zip(vertices, numbers)}


def _numbered(graph: Graph, period: int) -> dict[int, PoseName]:
    """Return names for the poses of a graph without any."""
    following: dict[int, int] = {}
    preceding: dict[int, int] = {}
    for edge in sorted(graph.increments, key=lambda edge: edge.end - edge.begin):
        begin, end = edge.begin, edge.end
        if begin < end and begin not in following and end not in preceding:
            following[begin], preceding[end] = end, begin
    names = {}
    for robot, first in enumerate(sorted(following.keys() - preceding.keys()), start=1):
        vertex: int | None = first
        stamp = LOG_START
        while vertex is not None:
            names[vertex] = PoseName(f'r{robot}', stamp)
            vertex, stamp = following.get(vertex), stamp + period
    return names
