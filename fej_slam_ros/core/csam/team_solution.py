# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The solution for a whole team: the robots' maps alone, joined where they met, with covariances.

All of it is one pure function of plain values, which another process may call.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256

import numpy as np

from fej_slam_ros.core.csam import joining
from fej_slam_ros.core.csam.base_node import BaseNode
from fej_slam_ros.core.csam.joining import JoinRules, RendezvousMeasurement
from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.csam.outlier_removal import minimum, Outlier
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import (
    Array, compose, Indices, pose_rotation, rotation, transform, transform_poses)
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing.least_squares import ConvergenceError
from fej_slam_ros.core.smoothing.normal_equations import SingularError


@dataclass(frozen=True, slots=True, eq=False)
class SmoothingTask:
    """
    What is to be solved.

    Attributes
    ----------
    maps : of the robots alone, the anchor's first; their values are where to start
    meetings : of these robots
    anchor, anchor_pose : name of the robot whose start is known in ``map``, '' for none, and where
        (3,) that is [m, m, rad]
    rules : when robots are joined
    gate_probability : with this one no right observation of a robot is left out; 1.0 takes all

    """

    maps: tuple[LocalMap, ...]
    meetings: tuple[RendezvousMeasurement, ...]
    anchor: str
    anchor_pose: Array
    rules: JoinRules = joining.DEFAULT
    gate_probability: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedTrajectory:
    """
    The way of one robot in a map.

    Attributes
    ----------
    poses : (n, 3) array [m, m, rad]
    P : (n, 3, 3) array, their covariances in the same frame
    landmarks : (l,) array, for each landmark of the robot's own, by number, which of the map it is

    """

    poses: Array
    P: Array
    landmarks: Indices


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedMap:
    """
    The map of one robot, or of several that are joined.

    Attributes
    ----------
    frame : its name; ``map`` where others are joined with the anchor
    ways : of its robots, by name; the frame is that of the first, but for the anchor's pose
    base_nodes : where the frames of the others lie
    landmarks : what each landmark is called; several names where maps share it
    points, P : (l, 2) and (l, 2, 2) arrays, where the landmarks are [m], and their covariances
    chi_square, dof : cost of the minimum, and its degrees of freedom

    """

    frame: str
    ways: Mapping[str, SmoothedTrajectory]
    base_nodes: Mapping[str, BaseNode]
    landmarks: tuple[tuple[LandmarkKey, ...], ...]
    points: Array
    P: Array
    chi_square: float
    dof: int


@dataclass(frozen=True, slots=True, eq=False)
class TeamMap:
    """
    What came of a task.

    Attributes
    ----------
    maps : each robot is part of one, but for those that are unsolved
    not_joined : which robots were not joined, and why
    unsolved : for each robot whose map has no minimum, or no covariances, why
    outliers : of each robot, the observations that are left out

    """

    maps: tuple[SmoothedMap, ...] = ()
    not_joined: tuple[JoinFailure, ...] = ()
    unsolved: Mapping[str, str] = field(default_factory=dict)
    outliers: Mapping[str, Sequence[Outlier]] = field(default_factory=dict)

    def has_joined(self, robots: Collection[str]) -> bool:
        """Return whether some robots are part of one map."""
        return any({*robots} <= solved.ways.keys() for solved in self.maps)

    def landmarks_in_map(self) -> int:
        """Return how many landmarks there are in ``map``."""
        return sum(len(solved.points) for solved in self.maps if solved.frame == MAP)


def solve(task: SmoothingTask) -> TeamMap:
    """Return the minimum of each map alone, joined where robots met, and all covariances."""
    unsolved: dict[str, str] = {}
    outliers: dict[str, Sequence[Outlier]] = {}
    minima = list(_minima(task, unsolved, outliers))
    here = [alone.robot for alone in minima]
    meetings = [met for met in task.meetings if {met.observer, met.seen} <= {*here}]
    try:
        joined, not_joined = joining.join_maps(minima, meetings, task.rules)
    except (ConvergenceError, SingularError) as error:
        return TeamMap(unsolved=unsolved | dict.fromkeys(here, str(error)))
    own_keys = {alone.robot: alone.landmarks for alone in minima}
    maps = []
    for joint in joined:
        try:
            maps.append(_placed(_smoothed(joint, own_keys), task))
        except SingularError as error:  # noqa: PERF203
            unsolved |= dict.fromkeys(joint.robots, str(error))
    return TeamMap(tuple(maps), tuple(not_joined), unsolved, outliers)


def _minima(
    task: SmoothingTask, unsolved: dict[str, str], outliers: dict[str, Sequence[Outlier]]
) -> Iterator[LocalMap]:
    """Yield the maps at their minimum; note what is left out, and where there is no minimum."""
    for alone in task.maps:
        try:
            solved, outliers[alone.robot] = minimum(alone, task.gate_probability)
        except (ConvergenceError, SingularError) as error:  # noqa: PERF203
            unsolved[alone.robot] = str(error)
        else:
            yield solved


def _smoothed(joint: JointMap, own_keys: Mapping[str, Sequence[LandmarkKey]]) -> SmoothedMap:
    """Return a map with its covariances, in the frame of its first robot."""
    values = joint.values
    P_poses, P = joint.information().marginals()
    numbers = joint.numbers()
    firsts = [joint.first_poses[robot] for robot in joint.robots]
    ways = {
        robot: SmoothedTrajectory(
            values.poses[first:end], P_poses[first:end],
            np.array([numbers[key] for key in own_keys[robot]], np.intp))
        for robot, first, end in zip(joint.robots, firsts, [*firsts[1:], len(values.poses)])}
    return SmoothedMap(
        own_frame(joint.robots[0]), ways, joint.base_nodes, joint.landmarks, values.points, P,
        joint.chi_square, joint.dof)


def _placed(alone: SmoothedMap, task: SmoothingTask) -> SmoothedMap:
    """Return a map in ``map`` where others are joined with the anchor, else as it is."""
    if len(alone.ways) == 1 or task.anchor not in alone.ways:
        return alone
    at = task.anchor_pose
    C, C_pose = rotation(at[2]), pose_rotation(at[2])
    return replace(
        alone, frame=MAP,
        ways={
            robot: replace(
                way, poses=transform_poses(at, way.poses), P=C_pose @ way.P @ C_pose.T)
            for robot, way in alone.ways.items()},
        base_nodes={
            robot: BaseNode(compose(at, base.pose), C_pose @ base.P @ C_pose.T)
            for robot, base in alone.base_nodes.items()},
        points=transform(at, alone.points), P=C @ alone.P @ C.T)


def state_hash(
    solution: TeamMap, robots: Sequence[str], stamps: Mapping[str, Sequence[int]]
) -> str:
    """
    Return SHA-256 over what was smoothed, in canonical order.

    For each map: its frame; of each of its robots, in the given order, the name, and stamps, poses
    and covariances up to the solution; of each landmark, by identity, its names, place and
    covariance. Texts are UTF-8, integers and floats 8 bytes of this machine's order.

    """
    digest = sha256()
    for solved in solution.maps:
        digest.update(solved.frame.encode())
        for name in [name for name in robots if name in solved.ways]:
            way = solved.ways[name]
            digest.update(name.encode() + np.array(stamps[name][:len(way.poses)]).tobytes())
            digest.update(way.poses.tobytes() + way.P.tobytes())
        for number in sorted(range(len(solved.points)), key=solved.landmarks.__getitem__):
            for owner, id_ in solved.landmarks[number]:
                digest.update(owner.encode() + np.int64(id_).tobytes())
            digest.update(solved.points[number].tobytes() + solved.P[number].tobytes())
    return digest.hexdigest()
