# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Robots that drive on a disc with a fixed density of landmarks, for any number of landmarks.

There is one landmark per 20 m^2, a square of 4.5 m; each robot observes the nearest ones at every
step.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, WHOLE_MAP
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.geometry import Array, compose, Indices, inverse
from fej_slam_ros.core.models import h
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.core.records import Motion, Observation, Scan

DRIVE_ROBOTS = ('r1', 'r2')
#: Area per landmark [m^2].
LANDMARK_AREA = 20.0
#: Covariance of odometry over a metre, of an observation and its standard deviation [m], and of a
#: start pose.
METRE_Q = np.diag([0.05, 0.05, 0.01]) ** 2
DRIVE_SIGMA = 0.1
DRIVE_R = DRIVE_SIGMA ** 2 * np.eye(2)
#: Standard deviations of a range [m] and a bearing [rad]; the latter is DRIVE_SIGMA at 5 m.
RANGE_SIGMA, BEARING_SIGMA = DRIVE_SIGMA, 0.02
START_P = np.diag([0.05, 0.05, 0.002]) ** 2
#: Poses (3,) and covariances (3, 3) of robots by name.
RobotEstimates = dict[str, tuple[Array, Array]]
#: Motions and scans of a step.
Measurements = tuple[Sequence[Motion], Sequence[Scan]]
#: Returns z (m, 2) and R (m, 2, 2) of observations from their true values (m, 2).
Sensor = Callable[[Array, np.random.Generator], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class SyntheticDrive:
    """Measurements of some robots."""

    starts: Mapping[str, Array]  #: True poses at stamp 0, known with covariance START_P
    survey: Scan  #: A scan of all landmarks by the first robot at stamp 0
    steps: Sequence[Measurements]
    poses: Array  #: (steps, robots, 3) array, true poses after each step


def fej_filter(
    poses: Mapping[str, Array], P: Array, submap: ActiveSubmap = WHOLE_MAP
) -> Filter:
    """Return an FEJ filter without gate, with robots at known poses with covariance P (3, 3)."""
    team = Filter(JointState(), FirstEstimates(), Gate(1.0), submap=submap)
    for name, pose in poses.items():
        team.state.insert_robot(name, 0, pose, P)
    return team


def cartesian(true: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return observations with equal and independent errors of x and y."""
    return true + rng.normal(0.0, DRIVE_SIGMA, true.shape), np.tile(DRIVE_R, (len(true), 1, 1))


def range_bearing(true: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return observations with independent errors of range and bearing."""
    noise = rng.normal(0.0, (RANGE_SIGMA, BEARING_SIGMA), true.shape)
    measured = [
        polar(r, beta, RANGE_SIGMA, BEARING_SIGMA) for r, beta in zip(
            np.hypot(*true.T) + noise[:, 0], np.arctan2(true[:, 1], true[:, 0]) + noise[:, 1])]
    return np.array([z for z, _ in measured]), np.array([R for _, R in measured])


def drive(
    landmarks: int, steps: int, stride: float, observations: int, rng: np.random.Generator,
    robots: int = len(DRIVE_ROBOTS), sensor: Sensor = cartesian,
) -> SyntheticDrive:
    """Move each robot by a stride [m] and scan the nearest landmarks at every step."""
    radius = np.sqrt(LANDMARK_AREA * landmarks / np.pi)
    distance = radius * np.sqrt(rng.uniform(size=landmarks))
    angle = rng.uniform(-np.pi, np.pi, landmarks)
    points = np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])
    starts = {
        name: np.array([x * radius, 0.0, 0.0])
        for name, x in zip(DRIVE_ROBOTS[:robots], (-0.3, 0.3))}
    poses, measurements, true_poses = dict(starts), [], []

    def scan(name: str, stamp: int, pose: Array, ids: Indices) -> Scan:
        z, R = sensor(h(np.tile(pose, (len(ids), 1)), points[ids]), rng)
        return Scan(name, stamp, tuple(map(Observation, ids.tolist(), z, R)))

    for k in range(1, steps + 1):
        motions, scans = [], []
        for name in starts:
            u = np.array([stride, 0.0, _turn(poses[name], stride, radius, rng)])
            poses[name] = pose = compose(poses[name], u)
            Q = stride * METRE_Q
            motions.append(Motion(name, k, rng.multivariate_normal(u, Q), Q))
            nearest = np.argsort(np.hypot(*(points - pose[:2]).T))[:observations]
            scans.append(scan(name, k, pose, nearest))
        measurements.append((motions, scans))
        true_poses.append([*poses.values()])
    survey = scan('r1', 0, starts['r1'], np.arange(landmarks))
    return SyntheticDrive(starts, survey, measurements, np.array(true_poses))


def _turn(pose: Array, stride: float, radius: float, rng: np.random.Generator) -> float:
    """Return the turn of a step: random, but towards the centre near the edge."""
    if np.hypot(*pose[:2]) > 0.9 * radius:
        centre = inverse(pose)
        return 0.3 * stride * float(np.sign(centre[1]))
    return float(rng.normal(0.0, 0.1 * np.sqrt(stride)))
