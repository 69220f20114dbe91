# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The filter beside what a user might take instead.

All get the same data in one process: two robots that know their starts and no landmark move by
1 m and see the nearest ten landmarks at every step, and after each the poses and covariances of
both are asked for. The order changes from step to step, as some leave cold caches behind.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Protocol

import numpy as np

from fej_slam_ros.benchmark.machine import Times
from fej_slam_ros.benchmark.synthetic_drive import drive, P_0, ROBOTS, SyntheticDrive
from fej_slam_ros.benchmark.textbook import Textbook
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, AROUND_ROBOTS, WHOLE_MAP
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Motion, Scan
from fej_slam_ros.experiments.liu.metrics import root_mean_square

LANDMARKS = 100, 300, 1000
STRIDE = 1.0
OBSERVATIONS = 10

#: What all others are compared with: the filter as the estimator runs it.
OURS = 'fej, compressed by size'

Found = dict[str, tuple[Array, Array]]


class Peer(Protocol):
    """An estimator of robots and landmarks."""

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> object:
        """Add a robot whose pose is known with covariance P (3, 3)."""

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> Found:
        """Take in what happened at one stamp; return the robots' poses and covariances."""


class Ours:
    """The FEJ filter of this package."""

    def __init__(self, regions: ActiveSubmap) -> None:
        self._team = Filter(JointState(), FirstEstimates(), Gate(1.0), submap=regions)
        self.insert_robot = self._team.state.insert_robot

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> Found:
        """Take in what happened at one stamp; return the robots' poses and covariances."""
        self._team.step(motions, scans)
        state = self._team.state
        return {
            name: (state.estimate(robot), state.marginal([robot]))
            for name, robot in state.robots.items()}


@dataclass(frozen=True)
class PeerTime:
    """
    What one of them took.

    Attributes
    ----------
    name : whose times these are
    landmarks, found : how many there are, and how many were seen
    steps : how many were made
    times : of a step
    late : mean over the last quarter of the steps [s]
    rmse : of the positions of both robots over all steps [m]

    """

    name: str
    landmarks: int
    found: int
    steps: int
    times: Times
    late: float
    rmse: float


#: Who takes part wherever this package is; who needs more is named by the caller.
PEERS: dict[str, Callable[[], Peer]] = {
    OURS: partial(Ours, AROUND_ROBOTS), 'fej, dense': partial(Ours, WHOLE_MAP),
    'textbook EKF': Textbook}


def peer_times(
    landmarks: int, steps: int, others: Mapping[str, Callable[[], Peer]]
) -> list[PeerTime]:
    """Time everybody's steps among so many landmarks."""
    made = drive(landmarks, steps, STRIDE, OBSERVATIONS, np.random.default_rng(landmarks))
    return race({name: make() for name, make in {**PEERS, **others}.items()}, made, landmarks)


def race(taking_part: Mapping[str, Peer], made: SyntheticDrive, landmarks: int) -> list[PeerTime]:
    """Let everybody make the same steps, each in an order of its own."""
    seconds: dict[str, list[float]] = {name: [] for name in taking_part}
    errors: dict[str, list[Array]] = {name: [] for name in taking_part}
    for peer in taking_part.values():
        for robot, pose in made.starts.items():
            peer.insert_robot(robot, 0, pose, P_0)
    # A turn that only shifts would leave everybody behind the same one.
    rng, names = np.random.default_rng(1), [*taking_part]
    for (motions, scans), truth in zip(made.happened, made.poses):
        for name in rng.permuted(names).tolist():
            begin = perf_counter()
            found = taking_part[name].step(motions, scans)
            seconds[name].append(perf_counter() - begin)
            errors[name].append(np.array([found[robot][0] for robot in ROBOTS]) - truth)
    seen = {s.id for _, scans in made.happened for scan in scans for s in scan.observations}
    return [
        PeerTime(
            name, landmarks, len(seen), len(of_steps), Times.of(of_steps),
            float(np.mean(of_steps[-(len(of_steps) // 4):])),
            root_mean_square(np.array(errors[name])[..., :2].reshape(-1, 2)))
        for name, of_steps in seconds.items()]
