# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The experiments of [Andersson], section V: what two robots gain by joining their maps.

Each robot smooths its way and map alone, numbering landmarks for itself; then the maps are joined
by the observations that the robots had of each other. What comes of it is rated by the truth.
"""

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.consistency import nees, pose_error
from fej_slam_ros.core.csam import team_solution
from fej_slam_ros.core.csam.joining import join_maps, RendezvousMeasurement
from fej_slam_ros.core.csam.maps import JointMap, LocalMap, merged
from fej_slam_ros.core.csam.message_sizes import sizes
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.geometry import Array, between, transform
from fej_slam_ros.core.records import LandmarkKey, Record
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.experiments.andersson.scenes import scene
from fej_slam_ros.sim.encounters import Encounter

#: Names of the experiments with what the paper calls them.
EXPERIMENTS = {'map_joining': 'A, map joining', 'sensor_extension': 'B, sensor extension'}
#: Where fewer landmarks are in view, hardly anything but odometry tells the heading.
MIN_IN_VIEW = 2


class CsamTask(NamedTuple):
    """One run: the name of an experiment, and the seed of everything in it."""

    experiment: str
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class CsamSolution:
    """
    A run with all that was estimated in it.

    Attributes
    ----------
    task : which one it is
    truth : what is true
    maps : what each robot mapped alone, P first
    measurements : robot-to-robot observations
    joint : the map of both in the frame of P, None where they were not joined
    refusal : why they were not, '' where they were

    """

    task: CsamTask
    truth: Encounter
    maps: tuple[LocalMap, ...]
    measurements: tuple[RendezvousMeasurement, ...]
    joint: JointMap | None
    rejection_reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Gain:
    """
    How good a joint map is, and what each robot has gained by it.

    Attributes
    ----------
    found, false : landmarks of P and Q that were made one, rightly and wrongly
    nees : of the ``poses`` of both robots, the ``landmarks`` and the ``base_node``, in the frame
        of P, divided by the degrees of freedom and averaged
    chi_square : of the joint map, divided by its degrees of freedom
    before, joined : (K + 1,) arrays of each robot, standard deviation of the heading [rad] at each
        sample, in the frame of the robot's own start, in its own map and in the joint one
    q_over_p : mean of Q's over mean of P's, both in the joint map in the frame of P's start
    blind : the samples between which Q is without landmarks for the longest time

    """

    found: int
    false: int
    nees: Mapping[str, float]
    chi_square: float
    before: Mapping[str, Array]
    joined: Mapping[str, Array]
    q_over_p: float
    blind: tuple[int, int]

    def ratio(self, robot: str) -> Array:
        """Return (K,) deviations of a robot's heading after its start, joined over before."""
        return self.joined[robot][1:] / self.before[robot][1:]

    def big_step(self, of: Mapping[str, Array]) -> float:
        """Return by how much [rad] Q's deviation, in `before` or `joined`, rises while blind."""
        *_, of_q = of.values()
        begin, end = self.blind
        return float(of_q[end] - of_q[begin])


@dataclass(frozen=True, slots=True, eq=False)
class CsamRun:
    """
    What came of a run.

    Attributes
    ----------
    task : which one it is
    shared : landmarks that both robots saw
    sizes : length [bytes] of each form of message that aligns the maps, by robot
    gain : what came of joining, None where the maps were not joined
    refusal : why they were not, '' where they were

    """

    task: CsamTask
    shared: int
    sizes: Mapping[str, Mapping[str, int]]
    gain: Gain | None
    rejection_reason: str


def run(task: CsamTask) -> CsamRun:
    """Make a run and rate it."""
    solved = solve(task)
    p, q = ({_true(solved.truth, key) for key in local.landmarks} for local in solved.maps)
    return CsamRun(
        task, len(p & q),
        {sender: of for (sender, _), of in sizes(solved.maps, solved.measurements).items()},
        None if solved.joint is None else gain(solved.truth, solved.maps, solved.joint),
        solved.rejection_reason)


def solve(task: CsamTask) -> CsamSolution:
    """Make a run: both maps alone, and the joint one."""
    truth, records = scene(*task)
    measured = _measured(truth.robots, records)
    groups, failed = join_maps(measured.maps, measured.measurements)
    joint = groups[0] if len(groups) == 1 else None
    rejection_reason = '; '.join(pair.reason for pair in failed)
    return CsamSolution(task, truth, measured.maps, measured.measurements, joint, rejection_reason)


def _measured(robots: Sequence[str], records: Iterable[Record]) -> team_solution.SmoothingTask:
    """Return what the smoother of a team makes of records, before it is solved for."""
    team = TeamSmoother(Settings(
        tuple(RobotSettings(name, id=k) for k, name in enumerate(robots, start=1)), robots[0],
        shared_landmark_ids=False))
    for record in records:
        team.add(record)
    deque(team.close(), maxlen=0)
    return team.task()


def gain(truth: Encounter, maps: Sequence[LocalMap], joint: JointMap) -> Gain:
    """Rate a joint map of two robots."""
    pairs = [{_true(truth, key) for key in keys} for keys in joint.landmarks if len(keys) > 1]
    found = sum(len(pair) == 1 for pair in pairs)
    P, P_points = joint.information().marginals()
    of_p, of_q = np.split(np.sqrt(P[:, 2, 2]), [joint.first_poses[maps[1].robot]])
    return Gain(
        found, len(pairs) - found, _nees(truth, joint, P, P_points), joint.chi_square / joint.dof,
        {local.robot: heading_sigmas(JointMap.of(local), local.robot) for local in maps},
        {local.robot: heading_sigmas(joint, local.robot) for local in maps},
        float(of_q[1:].mean() / of_p[1:].mean()), blind(maps[1]))


def heading_sigmas(of: JointMap, robot: str) -> Array:
    """Return (K + 1,) deviations of a robot's heading [rad], in the frame of its start."""
    P, _ = in_own_frame(of, robot).information().marginals()
    return np.sqrt(P[poses_of(of, robot), 2, 2])


def in_own_frame(of: JointMap, robot: str) -> JointMap:
    """Return a map in the frame of the start of one of its robots, which is certain there."""
    return of.in_frame_of(of.first_poses[robot])


def poses_of(of: JointMap, robot: str) -> slice:
    """Return the numbers of a robot's poses."""
    first = of.first_poses[robot]
    later = [other for other in of.first_poses.values() if other > first]
    return slice(first, min(later, default=len(of.values.poses)))


def blind(local: LocalMap) -> tuple[int, int]:
    """
    Return the samples between which a robot is without landmarks for the longest time.

    That is the last one before and the first one after a time in which fewer than two are in
    view, so that the robot has to rely on its odometry.

    """
    in_view = np.bincount(local.problem.landmarks.pose, minlength=len(local.values.poses))
    seeing = np.flatnonzero(in_view >= MIN_IN_VIEW)
    longest = int(np.argmax(np.diff(seeing)))
    return int(seeing[longest]), int(seeing[longest + 1])


def before_association(maps: Sequence[LocalMap], joint: JointMap) -> JointMap:
    """Return the map that two joined robots have by their observations of each other alone."""
    p, q = map(JointMap.of, maps)
    base_node = joint.base_nodes[maps[1].robot]
    apart = merged(p, q, base_node.pose)
    return replace(apart, problem=replace(
        apart.problem, rendezvous=joint.problem.rendezvous)).solved()


def _true(truth: Encounter, key: LandmarkKey) -> int:
    """Return the landmark that a robot's own number means."""
    robot, number = key
    return truth.landmark_of[robot][number]


def _nees(truth: Encounter, joint: JointMap, P: Array, P_points: Array) -> dict[str, float]:
    """Return the mean NEES of all but the start of P, which is certain."""
    start = truth.true_poses[truth.robots[0]][0]
    poses = [between(start, pose) for robot in joint.robots for pose in truth.true_poses[robot]]
    errors = np.array([pose_error(*pair) for pair in zip(joint.values.poses, poses)])
    points = np.array([truth.landmarks[_true(truth, keys[0])] for keys in joint.landmarks])
    (robot, base), = joint.base_nodes.items()
    at = between(start, truth.true_poses[robot][0])
    return {
        'poses': float(nees(errors[1:], P[1:]).mean()),
        'landmarks': float(nees(
            joint.values.points - transform(between(start, np.zeros(3)), points),
            P_points).mean()),
        'base_node': float(nees(pose_error(base.pose, at), base.P))}
