# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Time of a new pose of a smoother while the trajectory grows, beside other smoothers.

One robot moves by 1 m and observes the nearest five of 100 landmarks at every step; whole
solutions are part of the steps in which they are due. After each step the newest pose and its
covariance are requested.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.benchmark.machine import Times
from fej_slam_ros.benchmark.peers import Peer, run_race
from fej_slam_ros.benchmark.synthetic_drive import drive, DRIVE_ROBOTS, RobotEstimates
from fej_slam_ros.core.consistency import root_mean_square
from fej_slam_ros.core.geometry import Array, compose
from fej_slam_ros.core.records import Motion, Scan
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother

GROWTH_LANDMARKS, GROWTH_OBSERVATIONS, GROWTH_STRIDE = 100, 5, 1.0
#: Windows into which the poses of a run are divided.
WINDOWS = 10
ROBOT = DRIVE_ROBOTS[0]
OUR_SMOOTHER = 'smoother'


class OurSmoother:
    """The smoother of this package, of one robot in the frame of its start."""

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> None:
        """Start at a pose, which is exact in the frame of the smoother."""
        self._name, self._start, self._smoother = name, pose, IncrementalSmoother()

    def step(self, motions: Sequence[Motion], scans: Sequence[Scan]) -> RobotEstimates:
        """Process the measurements of one stamp; P is in the frame of the start."""
        (motion,), (scan,) = motions, scans
        self._smoother.add(motion.u, motion.Q, scan.observations)
        return {self._name: (compose(self._start, self._smoother.pose), self._smoother.P)}


@dataclass(frozen=True)
class GrowthTime:
    """Times of a smoother in a window of poses."""

    name: str
    poses: int  #: Number of poses at the end of the window
    times: Times  #: Of a new pose
    rmse: float  #: Of the newest positions in the window [m]


def growth_times(
    poses: int, others: Mapping[str, Callable[[], Peer]]
) -> list[GrowthTime]:
    """Time the new poses of all smoothers, window by window."""
    measured = drive(
        GROWTH_LANDMARKS, poses, GROWTH_STRIDE, GROWTH_OBSERVATIONS, np.random.default_rng(1))
    peers: dict[str, Peer] = {
        OUR_SMOOTHER: OurSmoother(), **{name: make() for name, make in others.items()}}
    seconds, errors = run_race(
        peers, {ROBOT: measured.starts[ROBOT]},
        [(motions[:1], scans[:1]) for motions, scans in measured.steps], measured.poses[:, :1])
    return [
        GrowthTime(
            name, int(window[-1]) + 1, Times.of([seconds[name][k] for k in window]),
            root_mean_square(errors[name][window, 0, :2]))
        for window in np.array_split(np.arange(poses), WINDOWS) for name in peers]
