# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Solution of a whole team: local maps, joined by rendezvous and landmarks, with covariances.

`solve` is a pure function of plain values, so that another process may call it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.csam.base_node import BaseNode
from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.csam.map_merging import join_maps, ScaledJoin
from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.csam.odometry_links import ReleasedOdometry
from fej_slam_ros.core.csam.outlier_removal import Outlier
from fej_slam_ros.core.csam.own_slips import own_map, OwnMap
from fej_slam_ros.core.csam.rendezvous import RendezvousMeasurement
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import (
    Array, compose, Indices, pose_rotation, rotation, transform, transform_poses)
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing.marginals import Information
from fej_slam_ros.core.smoothing.newest_pose import NearMarginal


@dataclass(frozen=True, slots=True, eq=False)
class SmoothingTask:
    """Input of `solve`."""

    #: local maps, the anchor's first, with pose 0 as the origin; their values are the start
    maps: tuple[LocalMap, ...]
    #: robot-to-robot observations in the order of time
    measurements: tuple[RendezvousMeasurement, ...]
    #: anchor, anchor_pose, P_anchor: name of the robot whose pose 0 is known, '' for none, this
    #: pose (3,) in ``map`` [m, m, rad] and its covariance (3, 3)
    anchor: str
    anchor_pose: Array
    P_anchor: Array
    rules: JoinRules  #: conditions for joining
    #: probability that no correct observation of a robot is removed; 1.0 keeps all
    gate_probability: float


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedTrajectory:
    """Trajectory of one robot in a map."""

    poses: Array  #: (n, 3) array [m, m, rad]
    P: Array  #: (n, 3, 3) array, their covariances in the same frame
    landmarks: Indices  #: (l,) array, index in the map of each landmark of the robot's local map
    near: NearMarginal  #: joint covariance of the last pose and of the landmarks around it


@dataclass(frozen=True, slots=True, eq=False)
class SmoothedMap:
    """Map of one robot, or of several joined ones."""

    #: ``map`` if other robots are joined with the anchor, else the first robot's own frame
    frame: str
    trajectories: Mapping[str, SmoothedTrajectory]  #: of its robots, by name
    base_nodes: Mapping[str, BaseNode]  #: of all robots but the first, by name
    #: keys of each landmark; more than one if landmarks were merged
    landmarks: tuple[tuple[LandmarkKey, ...], ...]
    #: points, P: (l, 2) and (l, 2, 2) arrays, positions of the landmarks [m] and their covariances
    points: Array
    P: Array
    #: chi_square, dof: cost of the minimum, and its degrees of freedom
    chi_square: float
    dof: int


@dataclass(frozen=True, slots=True, eq=False)
class TeamMap:
    """Result of `solve`."""

    #: the maps; each robot that is not in `unsolved` is in one of them
    maps: tuple[SmoothedMap, ...] = ()
    #: rendezvous, or single observations, by which robots were not joined, and landmarks that
    #: were not merged
    not_joined: tuple[JoinFailure, ...] = ()
    #: error message of each robot whose map has no minimum or no covariances
    unsolved: Mapping[str, str] = field(default_factory=dict)
    #: removed landmark observations of each robot
    outliers: Mapping[str, Sequence[Outlier]] = field(default_factory=dict)
    #: odometry of robots whose wheels slipped
    released: tuple[ReleasedOdometry, ...] = ()
    scaled: tuple[ScaledJoin, ...] = ()  #: joined maps whose scales differ

    def has_joined(self, robots: Collection[str]) -> bool:
        """Return whether all these robots are in one map."""
        return any({*robots} <= solved.trajectories.keys() for solved in self.maps)

    def without(self, robots: Collection[str]) -> 'TeamMap':
        """Return the result without the maps of some robots, and reports on their poses."""
        return replace(
            self, maps=tuple(
                solved for solved in self.maps if solved.trajectories.keys().isdisjoint(robots)),
            outliers={name: x for name, x in self.outliers.items() if name not in robots},
            released=tuple(r for r in self.released if r.robot not in robots))

    def landmarks_in_map(self) -> int:
        """Return the number of landmarks in ``map``."""
        return sum(len(solved.points) for solved in self.maps if solved.frame == MAP)


def solve(task: SmoothingTask) -> TeamMap:
    """
    Return the joined maps of a team with all covariances.

    They are joined in the order of the names of the robots, so that robots that solve for the same
    measurements have the same map, each in its own frame.

    """
    own_maps, unsolved = _own_maps(task)
    outliers = {robot: [*own.outliers] for robot, own in own_maps.items()}
    released = [own.released for own in own_maps.values() if own.released is not None]
    measurements = [m for m in task.measurements if {m.observer, m.observed} <= own_maps.keys()]
    try:
        joined = join_maps(
            [own_maps[robot].joint for robot in sorted(own_maps)], measurements, task.rules)
    except NoMinimumError as error:
        return TeamMap(unsolved=unsolved | dict.fromkeys(own_maps, str(error)))
    for robot, left_out in joined.outliers.items():
        outliers[robot] += left_out
    keys = {local.robot: local.landmarks for local in task.maps}
    maps = []
    for joint in _led_by_first(joined.maps, [local.robot for local in task.maps]):
        try:
            maps.append(_in_map_frame(_smoothed(joint, keys), task))
        except NoMinimumError as error:  # noqa: PERF203
            unsolved |= dict.fromkeys(joint.robots, str(error))
    return TeamMap(
        tuple(maps), tuple(joined.failures), unsolved, outliers, (*released, *joined.released),
        tuple(joined.scaled))


def _own_maps(task: SmoothingTask) -> tuple[dict[str, OwnMap], dict[str, str]]:
    """Return the solved map of each robot, and why others have no minimum."""
    maps, unsolved = {}, {}
    for local in task.maps:
        try:
            maps[local.robot] = own_map(
                JointMap.unsolved(local), task.gate_probability, task.rules.limit(3))
        except NoMinimumError as error:  # noqa: PERF203
            unsolved[local.robot] = str(error)
    return maps, unsolved


def _led_by_first(maps: Sequence[JointMap], names: Sequence[str]) -> list[JointMap]:
    """Return maps in the order of the names of robots, each in the frame of its first one."""
    by_robot = {robot: joint for joint in maps for robot in joint.robots}
    led: dict[JointMap, JointMap] = {}
    for robot in filter(by_robot.__contains__, names):
        joint = by_robot[robot]
        if joint not in led:
            led[joint] = joint.led_by(robot)
    return [*led.values()]


def _smoothed(joint: JointMap, keys: Mapping[str, Sequence[LandmarkKey]]) -> SmoothedMap:
    """Return a map with its covariances, in the frame of its first robot."""
    values, information = joint.values, joint.information()
    P_poses, P = information.marginals()
    index = joint.landmark_index()
    trajectories = {}
    for robot in joint.robots:
        poses = joint.poses_of(robot)
        own = slice(poses.start, poses.stop)
        landmarks = np.array([index[key] for key in keys[robot]], np.intp)
        trajectories[robot] = SmoothedTrajectory(
            values.poses[own], P_poses[own], landmarks,
            _near(joint, information, robot, landmarks))
    return SmoothedMap(
        own_frame(joint.robots[0]), trajectories, joint.base_nodes(information),
        joint.landmarks, values.points, P, joint.chi_square, joint.dof)


def _near(
    joint: JointMap, information: Information, robot: str, landmarks: Indices
) -> NearMarginal:
    """
    Return the covariance with which the filter of a robot continues, without some landmarks.

    A landmark that others have elsewhere, so that the observations by this robot were left out, is
    a new one for its filter: the filter does not gate what the robot observes of it.

    """
    poses, factors = joint.poses_of(robot), joint.problem.landmarks
    by_robot = np.isin(factors.pose, poses)
    used = np.flatnonzero(np.isin(landmarks, factors.target[by_robot]))
    near = NearMarginal.of(information, joint.values, poses[-1], landmarks[used])
    return replace(near, landmarks=used[near.landmarks])


def _in_map_frame(solved: SmoothedMap, task: SmoothingTask) -> SmoothedMap:
    """Return a map in ``map`` if other robots are joined with the anchor, else unchanged."""
    if len(solved.trajectories) == 1 or task.anchor not in solved.trajectories:
        return solved
    anchor = task.anchor_pose
    C, C_pose = rotation(anchor[2]), pose_rotation(anchor[2])
    turned = replace(
        solved, frame=MAP,
        trajectories={
            robot: replace(
                x, poses=transform_poses(anchor, x.poses), P=C_pose @ x.P @ C_pose.T,
                near=x.near.turned(C))
            for robot, x in solved.trajectories.items()},
        base_nodes={
            robot: BaseNode(compose(anchor, b.pose), C_pose @ b.P @ C_pose.T)
            for robot, b in solved.base_nodes.items()},
        points=transform(anchor, solved.points), P=C @ solved.P @ C.T)
    return _with_frame_error(turned, anchor, task.P_anchor) if task.P_anchor.any() else turned


def _with_frame_error(solved: SmoothedMap, origin: Array, P: Array) -> SmoothedMap:
    """Return a map in a frame whose origin (3,) is uncertain itself, with covariance P (3, 3)."""
    def added(x: Array) -> Array:
        """Return the covariance (n, 3, 3) that poses or points x (n, d) gain."""
        G = models.Phi_all(x[:, :2] - origin[:2])
        return G @ P @ G.transpose(0, 2, 1)

    trajectories = {}
    for robot, x in solved.trajectories.items():
        near = solved.points[x.landmarks[x.near.landmarks]]
        G_pose, *G_points = models.Phi_all(np.vstack([x.poses[-1:, :2], near]) - origin[:2])
        G = np.vstack([G_pose, *(G_point[:2] for G_point in G_points)])
        trajectories[robot] = replace(
            x, P=x.P + added(x.poses), near=replace(x.near, P=x.near.P + G @ P @ G.T))
    return replace(
        solved, trajectories=trajectories,
        base_nodes={
            robot: replace(b, P=b.P + added(b.pose[None])[0])
            for robot, b in solved.base_nodes.items()},
        P=solved.P + added(solved.points)[:, :2, :2])


def solution_hash(
    solution: TeamMap, robots: Sequence[str], stamps: Mapping[str, Sequence[int]]
) -> str:
    """
    Return SHA-256 over a solution in canonical order.

    For each map: its frame; for each of its robots, in the given order, the name, and stamps,
    poses and covariances up to the solution; for each landmark, sorted by keys, its keys, position
    and covariance. Text is UTF-8; integers and floats have 8 bytes in native byte order.

    """
    digest = sha256()
    for solved in solution.maps:
        digest.update(solved.frame.encode())
        for name in filter(solved.trajectories.__contains__, robots):
            x = solved.trajectories[name]
            digest.update(name.encode() + np.array(stamps[name][:len(x.poses)]).tobytes())
            digest.update(x.poses.tobytes() + x.P.tobytes())
        for index in sorted(range(len(solved.points)), key=solved.landmarks.__getitem__):
            for owner, id_ in solved.landmarks[index]:
                digest.update(owner.encode() + np.int64(id_).tobytes())
            digest.update(solved.points[index].tobytes() + solved.P[index].tobytes())
    return digest.hexdigest()
