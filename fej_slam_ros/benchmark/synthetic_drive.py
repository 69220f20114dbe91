# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Two robots that drive on a disc with a fixed density of landmarks, for any number of landmarks.

There is one landmark per 20 m^2, a square of 4.5 m; each robot observes the nearest ones at every
step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, WHOLE_MAP
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.geometry import Array, compose, Indices, inverse
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import Motion, Observation, Scan

DRIVE_ROBOTS = ('r1', 'r2')
#: Area per landmark [m^2].
LANDMARK_AREA = 20.0
#: Covariance of odometry over a metre, of an observation and its standard deviation [m], and of a
#: start pose.
METRE_Q = np.diag([0.05, 0.05, 0.01]) ** 2
DRIVE_SIGMA = 0.1
DRIVE_R = DRIVE_SIGMA ** 2 * np.eye(2)
START_P = np.diag([0.05, 0.05, 0.002]) ** 2
#: Motions and scans of a step.
Measurements = tuple[Sequence[Motion], Sequence[Scan]]


@dataclass(frozen=True, eq=False)
class SyntheticDrive:
    """Measurements of two robots."""

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


def drive(
    landmarks: int, steps: int, stride: float, observations: int, rng: np.random.Generator
) -> SyntheticDrive:
    """Move each robot by a stride [m] and scan the nearest landmarks at every step."""
    radius = np.sqrt(LANDMARK_AREA * landmarks / np.pi)
    distance = radius * np.sqrt(rng.uniform(size=landmarks))
    angle = rng.uniform(-np.pi, np.pi, landmarks)
    points = np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])
    starts = {
        name: np.array([x * radius, 0.0, 0.0]) for name, x in zip(DRIVE_ROBOTS, (-0.3, 0.3))}
    poses, measurements, true_poses = dict(starts), [], []
    for k in range(1, steps + 1):
        motions, scans = [], []
        for name in DRIVE_ROBOTS:
            u = np.array([stride, 0.0, _turn(poses[name], stride, radius, rng)])
            poses[name] = pose = compose(poses[name], u)
            Q = stride * METRE_Q
            motions.append(Motion(name, k, rng.multivariate_normal(u, Q), Q))
            nearest = np.argsort(np.hypot(*(points - pose[:2]).T))[:observations]
            scans.append(_scan(name, k, pose, points, nearest, rng))
        measurements.append((motions, scans))
        true_poses.append([*poses.values()])
    survey = _scan('r1', 0, starts['r1'], points, np.arange(landmarks), rng)
    return SyntheticDrive(starts, survey, measurements, np.array(true_poses))


def _turn(pose: Array, stride: float, radius: float, rng: np.random.Generator) -> float:
    """Return the turn of a step: random, but towards the centre near the edge."""
    if np.hypot(*pose[:2]) > 0.9 * radius:
        centre = inverse(pose)
        return 0.3 * stride * float(np.sign(centre[1]))
    return float(rng.normal(0.0, 0.1 * np.sqrt(stride)))


def _scan(
    name: str, stamp: int, pose: Array, points: Array, ids: Indices, rng: np.random.Generator
) -> Scan:
    noise = rng.normal(0.0, DRIVE_SIGMA, (len(ids), 2))
    z = h(np.tile(pose, (len(ids), 1)), points[ids]) + noise
    return Scan(name, stamp, tuple(Observation(int(k), z_k, DRIVE_R) for k, z_k in zip(ids, z)))
