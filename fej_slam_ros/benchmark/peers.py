# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Comparison of the filter with alternatives on the same data.

Robots with known starts and no known landmark move by 1 m and observe the nearest ten landmarks at
every step, after which their poses and covariances are requested. There are two robots for peers
that run in this process, one for those that know no more. The order changes from step to step,
since some leave cold caches to the next; then each makes all steps alone, as on a core of its own.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from time import perf_counter
from typing import Protocol, runtime_checkable

import numpy as np

from fej_slam_ros.benchmark.machine import Times
from fej_slam_ros.benchmark.synthetic_drive import (
    drive, fej_filter, Measurements, range_bearing, RobotEstimates, START_P, SyntheticDrive)
from fej_slam_ros.benchmark.textbook import Textbook
from fej_slam_ros.core.consistency import root_mean_square
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, AROUND_ROBOTS, WHOLE_MAP
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Motion, Scan

PEER_LANDMARKS = 100, 300, 1000
#: Motion of a robot in a step [m], and number of landmarks that it observes.
PEER_STRIDE = 1.0
PEER_OBSERVATIONS = 10
#: Reference of the comparison: the filter as the estimator runs it.
OURS = 'fej, compressed by size'


class Peer(Protocol):
    """An estimator of robots and landmarks."""

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> object:
        """Add a robot whose pose is known with covariance P (3, 3)."""

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> RobotEstimates:
        """Process the measurements of one stamp; return the robots' poses and covariances."""


@runtime_checkable
class SelfTimed(Protocol):
    """A peer in a process of its own, whose time is without the transfer of input and output."""

    seconds: float  #: time of the last step


class Ours:
    """The FEJ filter of this package."""

    def __init__(self, submap: ActiveSubmap) -> None:
        self._team = fej_filter({}, START_P, submap)
        self.insert_robot = self._team.state.insert_robot

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> RobotEstimates:
        """Process the measurements of one stamp; return the robots' poses and covariances."""
        self._team.step(motions, scans)
        state = self._team.state
        return {
            name: (state.pose(robot), state.marginal([robot]))
            for name, robot in state.robots.items()}


@dataclass(frozen=True)
class PeerTime:
    """Step times and error of one peer."""

    name: str
    #: Number of landmarks, and of those that were observed.
    landmarks: int
    found: int
    steps: int  #: Number of steps
    times: Times  #: Of a step
    late: float  #: Mean over the last quarter of the steps [s]
    alone: float  #: Mean while no other peer runs [s]
    rmse: float  #: Of the positions of both robots over all steps [m]


#: The peers that need nothing but this package.
PEERS: dict[str, Callable[[], Peer]] = {
    OURS: partial(Ours, AROUND_ROBOTS), 'fej, dense': partial(Ours, WHOLE_MAP),
    'textbook EKF': Textbook}


def peer_times(
    landmarks: int, steps: int, others: Mapping[str, Callable[[], Peer]]
) -> list[PeerTime]:
    """Time the steps of all peers with a number of landmarks and two robots."""
    measured = drive(
        landmarks, steps, PEER_STRIDE, PEER_OBSERVATIONS, np.random.default_rng(landmarks))
    return race({**PEERS, **others}, measured, landmarks)


def one_robot_times(
    landmarks: int, steps: int, others: Mapping[str, Callable[[], Peer]]
) -> list[PeerTime]:
    """Time the steps of our filter and of others with one robot, which measures polar."""
    measured = drive(
        landmarks, steps, PEER_STRIDE, PEER_OBSERVATIONS, np.random.default_rng(landmarks),
        robots=1, sensor=range_bearing)
    return race({OURS: PEERS[OURS], **others}, measured, landmarks)


def race(
    peers: Mapping[str, Callable[[], Peer]], measured: SyntheticDrive, landmarks: int
) -> list[PeerTime]:
    """Let all peers make the same steps, together and alone; return their times and errors."""
    def run(names: Iterable[str]) -> tuple[dict[str, list[float]], dict[str, Array]]:
        instances = {name: peers[name]() for name in names}
        return run_race(instances, measured.starts, measured.steps, measured.poses)

    seconds, errors = run(peers)
    alone = {name: run([name])[0][name] for name in peers}
    observed = {s.id for _, scans in measured.steps for scan in scans for s in scan.observations}
    return [
        PeerTime(
            name, landmarks, len(observed), len(of_steps), Times.of(of_steps),
            float(np.mean(of_steps[-(len(of_steps) // 4):])), float(np.mean(alone[name])),
            root_mean_square(errors[name][..., :2].reshape(-1, 2)))
        for name, of_steps in seconds.items()]


def run_race(
    peers: Mapping[str, Peer], starts: Mapping[str, Array], steps: Sequence[Measurements],
    truth: Array,
) -> tuple[dict[str, list[float]], dict[str, Array]]:
    """
    Let all peers make the same steps, each step in another order of the peers.

    Parameters
    ----------
    peers : by name
    starts : start poses of the robots by name
    steps : measurements of these robots
    truth : (n, r, 3) array, their true poses after each step

    Returns
    -------
    seconds : time of each step of each peer
    errors : (n, r, 3) array of each peer, its poses after each step minus the true ones

    """
    seconds: dict[str, list[float]] = {name: [] for name in peers}
    poses: dict[str, list[list[Array]]] = {name: [] for name in peers}
    for peer in peers.values():
        for robot, pose in starts.items():
            peer.insert_robot(robot, 0, pose, START_P)
    # A cyclic order would run each peer after the same other one.
    rng, names = np.random.default_rng(1), [*peers]
    for motions, scans in steps:
        for name in rng.permuted(names).tolist():
            peer, begin = peers[name], perf_counter()
            estimates = peer.step(motions, scans)
            elapsed = perf_counter() - begin
            seconds[name].append(peer.seconds if isinstance(peer, SelfTimed) else elapsed)
            poses[name].append([estimates[robot][0] for robot in starts])
    return seconds, {name: np.array(peer_poses) - truth for name, peer_poses in poses.items()}
