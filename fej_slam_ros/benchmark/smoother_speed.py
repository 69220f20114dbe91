# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Times of the smoother: of batch least squares over a whole log, and of a new pose beside others.

For batch least squares the log has all poses of a robot and all landmarks. For a new pose, while
the trajectory grows, one robot moves by 1 m and observes the nearest five of 100 landmarks at
every step; whole solutions are part of the steps in which they are due. After each step the newest
pose and its covariance are requested.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fej_slam_ros.benchmark.machine import best, Times
from fej_slam_ros.benchmark.peers import Peer, run_race
from fej_slam_ros.benchmark.synthetic_drive import drive, DRIVE_ROBOTS, RobotEstimates
from fej_slam_ros.core.consistency import root_mean_square
from fej_slam_ros.core.geometry import Array, between, compose, wrap_all
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import Motion, Scan
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, OdometryFactors, Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import information
from fej_slam_ros.core.smoothing.normal_equations import Cholesky
from fej_slam_ros.core.smoothing.problem import Problem

#: Size of the whole log of Victoria Park, which has 6.6 observations per pose.
LOG_POSES, LOG_LANDMARKS, LOG_OBSERVATIONS = 6899, 299, 7
#: Covariances of an increment and of an observation.
LOG_Q = np.diag([0.01, 0.01, 0.001]) ** 2
LOG_R = np.diag([0.1, 0.1]) ** 2
GROWTH_LANDMARKS, GROWTH_OBSERVATIONS, GROWTH_STRIDE = 100, 5, 1.0
#: Windows into which the poses of a run are divided.
WINDOWS = 10
ROBOT = DRIVE_ROBOTS[0]
OUR_SMOOTHER = 'smoother'


@dataclass(frozen=True)
class SmootherTime:
    """Times of the parts of a solution [s]."""

    name: str  #: Of the data
    unknowns: int  #: Number of unknown coordinates
    begin: float  #: From the measurements to the first root: ordering, Jacobians, factorisation
    factorisation: float  #: Of another matrix with the same pattern
    marginals: float  #: Covariances of every pose and every landmark


def smoother_time(name: str, problem: Problem, values: Values) -> SmootherTime:
    """Time the parts of a solution, each the best of three."""
    solved = information(problem, values)
    return SmootherTime(
        name, len(solved.coordinates), best(lambda: information(problem, values), 3),
        best(lambda: Cholesky(solved.matrix), 3), best(solved.marginals, 3))


def synthetic_log() -> tuple[Problem, Values]:
    """Return one robot's loops and observations, of the size of the log of Victoria Park."""
    steps, rng = np.arange(LOG_POSES), np.random.default_rng(1)
    angles = np.linspace(0.0, 0.02 * LOG_POSES, LOG_POSES)
    # Each loop is beside the previous one.
    positions = (60.0 + 20.0 * np.sin(angles / 7.0)) * np.array([np.cos(angles), np.sin(angles)])
    poses = np.column_stack([*positions, wrap_all(angles + np.pi / 2.0)])
    points = poses[::LOG_POSES // LOG_LANDMARKS, :2][:LOG_LANDMARKS]
    points = points + rng.normal(0.0, 5.0, points.shape)
    distances = np.linalg.norm(poses[:, None, :2] - points, axis=2)
    landmark = np.argsort(distances, axis=1)[:, :LOG_OBSERVATIONS].ravel()
    pose = np.repeat(steps, LOG_OBSERVATIONS)
    u = np.array([between(a, b) for a, b in pairwise(poses)])
    z = h(poses[pose], points[landmark])
    odometry = OdometryFactors(steps[:-1], steps[1:], u, LOG_Q)
    return Problem(odometry, LandmarkFactors(pose, landmark, z, LOG_R)), Values(poses, points)


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
