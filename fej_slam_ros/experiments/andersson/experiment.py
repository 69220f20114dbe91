# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The experiments of [Andersson], section V: the gain of two robots that join their maps.

Each robot smooths its trajectory and map alone, with landmark IDs of its own; then the maps are
joined by the robots' observations of each other. The result is evaluated with ground truth.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.csam import team_solution
from fej_slam_ros.core.csam.map_merging import join_maps
from fej_slam_ros.core.csam.maps import JointMap, LocalMap, merged
from fej_slam_ros.core.csam.message_sizes import sizes
from fej_slam_ros.core.csam.rendezvous import RendezvousMeasurement
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.geometry import Array, between, inverse, pose_difference, transform
from fej_slam_ros.core.records import LandmarkKey, Record
from fej_slam_ros.core.settings import numbered_robots, Settings
from fej_slam_ros.sim.environments import RENDEZVOUS_ENVIRONMENTS
from fej_slam_ros.sim.rendezvous_world import RendezvousWorld

#: Names of the experiments with their titles in the paper.
EXPERIMENTS = {'map_joining': 'A, map joining', 'sensor_extension': 'B, sensor extension'}
#: With fewer landmarks in view the heading depends on odometry almost alone.
MIN_IN_VIEW = 2


class CsamTask(NamedTuple):
    """One run: the name of an experiment, and the seed of all its randomness."""

    experiment: str
    seed: int


class Scene(NamedTuple):
    """Ground truth and measurements of a run."""

    truth: RendezvousWorld
    records: tuple[Record, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CsamSolution:
    """A run with all its estimates."""

    task: CsamTask  #: The run
    truth: RendezvousWorld  #: Ground truth
    maps: tuple[LocalMap, ...]  #: Each robot's own map, P first
    measurements: tuple[RendezvousMeasurement, ...]  #: The robots' observations of each other
    joint: JointMap | None  #: The map of both in the frame of P, None if they were not joined
    rejection_reason: str  #: Why they were not joined, '' if they were


@dataclass(frozen=True, slots=True, eq=False)
class JoinGain:
    """Quality of a joint map, and the gain of each robot."""

    #: Numbers of right and of wrong associations of landmarks of P and Q.
    found: int
    false: int
    #: Mean NEES per degree of freedom of the ``poses`` of both robots, the ``landmarks`` and the
    #: ``base_node``, in the frame of P.
    nees: Mapping[str, float]
    chi_square: float  #: Of the joint map, per degree of freedom
    #: (K + 1,) arrays of each robot, standard deviation of the heading [rad] at each sample in the
    #: frame of the robot's own start, in its own map and in the joint one.
    before: Mapping[str, Array]
    joined: Mapping[str, Array]
    #: Mean of Q's over mean of P's, both in the joint map in the frame of P's start.
    q_over_p: float
    #: Samples before and after the longest time that Q is without landmarks.
    longest_gap: tuple[int, int]

    def ratio(self, robot: str) -> Array:
        """Return (K,) standard deviations of a robot's heading after its start, joined/before."""
        return self.joined[robot][1:] / self.before[robot][1:]

    def rise_in_gap(self, sigmas: Mapping[str, Array]) -> float:
        """Return the increase [rad] of Q's `before` or `joined` in its longest gap."""
        *_, of_q = sigmas.values()
        begin, end = self.longest_gap
        return float(of_q[end] - of_q[begin])


@dataclass(frozen=True, slots=True, eq=False)
class CsamRun:
    """Results of a run."""

    task: CsamTask  #: The run
    shared: int  #: Number of landmarks that both robots observed
    #: Length [bytes] of each form of message that aligns the maps, by robot.
    sizes: Mapping[str, Mapping[str, int]]
    gain: JoinGain | None  #: Result of joining, None if the maps were not joined
    rejection_reason: str  #: Why they were not joined, '' if they were


def run(task: CsamTask) -> CsamRun:
    """Make a run and evaluate it."""
    solution = solve(task)
    p, q = (
        {_true_id(solution.truth, key) for key in local.landmarks} for local in solution.maps)
    return CsamRun(
        task, len(p & q),
        {sender: form_sizes for (sender, _), form_sizes in sizes(
            solution.maps, solution.measurements).items()},
        None if solution.joint is None else gain(solution.truth, solution.maps, solution.joint),
        solution.rejection_reason)


def solve(task: CsamTask) -> CsamSolution:
    """Make a run: each robot's own map, and the joint one."""
    truth, records = scene(*task)
    smoothing = _smoothing_task(truth.robots, records)
    groups, failures, *_ = join_maps(
        [*map(JointMap.of, smoothing.maps)], smoothing.measurements)
    joint = groups[0] if len(groups) == 1 else None
    return CsamSolution(
        task, truth, smoothing.maps, smoothing.measurements, joint,
        '; '.join(failure.reason for failure in failures))


def scene(experiment: str, seed: int) -> Scene:
    """Return the scene of a run, the same as ``simulate`` makes."""
    environment = RENDEZVOUS_ENVIRONMENTS[experiment]
    return Scene(
        environment.true_world(np.random.default_rng(seed)),
        tuple(environment.records(np.random.default_rng(seed))))


def _smoothing_task(
    robots: Sequence[str], records: Sequence[Record]
) -> team_solution.SmoothingTask:
    """Return the task that a team's smoother makes of records, not yet solved."""
    team = TeamSmoother(Settings(numbered_robots(robots), robots[0], shared_landmark_ids=False))
    deque(team.run(records), maxlen=0)
    return team.task()


def gain(truth: RendezvousWorld, maps: Sequence[LocalMap], joint: JointMap) -> JoinGain:
    """Evaluate a joint map of two robots."""
    pairs = [{_true_id(truth, key) for key in keys} for keys in joint.landmarks if len(keys) > 1]
    found = sum(len(pair) == 1 for pair in pairs)
    P, P_points = joint.information().marginals()
    of_p, of_q = np.split(np.sqrt(P[:, 2, 2]), [joint.first_poses[maps[1].robot]])
    return JoinGain(
        found, len(pairs) - found, _nees(truth, joint, P, P_points), joint.chi_square / joint.dof,
        {local.robot: heading_sigmas(JointMap.of(local), local.robot) for local in maps},
        {local.robot: heading_sigmas(joint, local.robot) for local in maps},
        float(of_q[1:].mean() / of_p[1:].mean()), longest_gap(maps[1]))


def heading_sigmas(joint: JointMap, robot: str) -> Array:
    """Return (K + 1,) standard deviations of a robot's heading [rad], in its start's frame."""
    P, _ = in_own_frame(joint, robot).information().marginals()
    return np.sqrt(P[joint.poses_of(robot), 2, 2])


def in_own_frame(joint: JointMap, robot: str) -> JointMap:
    """Return a map in the frame of the start of one of its robots, which is exact there."""
    return joint.in_frame_of(joint.first_poses[robot])


def longest_gap(local: LocalMap) -> tuple[int, int]:
    """
    Return the last sample before and the first one after a robot's longest landmark gap.

    A gap is a time with fewer than two landmarks in view, in which the robot relies on odometry.
    """
    in_view = np.bincount(local.problem.landmarks.pose, minlength=len(local.values.poses))
    observing = np.flatnonzero(in_view >= MIN_IN_VIEW)
    longest = int(np.argmax(np.diff(observing)))
    return int(observing[longest]), int(observing[longest + 1])


def before_association(maps: Sequence[LocalMap], joint: JointMap) -> JointMap:
    """Return the map of two joined robots by their observations of each other alone."""
    p, q = map(JointMap.of, maps)
    base_node = joint.base_nodes(joint.information())[maps[1].robot]
    apart = merged(p, q, base_node.pose)
    return replace(apart, problem=replace(
        apart.problem, rendezvous=joint.problem.rendezvous)).solved()


def _true_id(truth: RendezvousWorld, key: LandmarkKey) -> int:
    """Return the true ID of a landmark with a robot's own ID."""
    robot, own_id = key
    return truth.landmark_of[robot][own_id]


def _nees(truth: RendezvousWorld, joint: JointMap, P: Array, P_points: Array) -> dict[str, float]:
    """Return the mean NEES per degree of freedom, without the start of P, which is exact."""
    start = truth.true_poses[truth.robots[0]][0]
    poses = [between(start, pose) for robot in joint.robots for pose in truth.true_poses[robot]]
    errors = pose_difference(joint.values.poses, np.array(poses))
    points = np.array([truth.landmarks[_true_id(truth, keys[0])] for keys in joint.landmarks])
    point_errors = joint.values.points - transform(inverse(start), points)
    (robot, base), = joint.base_nodes(joint.information()).items()
    base_error = pose_difference(base.pose, between(start, truth.true_poses[robot][0]))
    return {
        'poses': float(nees_per_dof(errors[1:], P[1:]).mean()),
        'landmarks': float(nees_per_dof(point_errors, P_points).mean()),
        'base_node': float(nees_per_dof(base_error, base.P))}
