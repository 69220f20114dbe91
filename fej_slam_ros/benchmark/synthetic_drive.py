# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Two robots that drive about on a disc with one density of landmarks, whatever its size.

A landmark has 20 m^2, the side of which is 4.5 m; each robot sees at every step the ones that are
nearest to it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, Indices
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import Motion, Observation, Scan

ROBOTS = ('r1', 'r2')
#: Area of a landmark [m^2].
AREA = 20.0
#: Of odometry over a metre, of an observation, and of where a robot starts.
Q = np.diag([0.05, 0.05, 0.01]) ** 2
SIGMA = 0.1
R = SIGMA ** 2 * np.eye(2)
P_0 = np.diag([0.05, 0.05, 0.002]) ** 2

Happened = tuple[Sequence[Motion], Sequence[Scan]]


@dataclass(frozen=True, eq=False)
class SyntheticDrive:
    """
    What two robots measured.

    Attributes
    ----------
    starts : their true poses at stamp 0, which are known with covariance P_0
    survey : a scan of all landmarks by the first robot at stamp 0
    happened : motions and scans of each step
    poses : (steps, robots, 3) array, the truth after each step

    """

    starts: Mapping[str, Array]
    survey: Scan
    happened: Sequence[Happened]
    poses: Array


def drive(
    landmarks: int, steps: int, stride: float, observations: int, rng: np.random.Generator
) -> SyntheticDrive:
    """Let each robot move by a stride [m] at every step, and see so many landmarks then."""
    radius = np.sqrt(AREA * landmarks / np.pi)
    away = radius * np.sqrt(rng.uniform(size=landmarks))
    angle = rng.uniform(-np.pi, np.pi, landmarks)
    points = np.column_stack([away * np.cos(angle), away * np.sin(angle)])
    starts = {
        name: np.array([share * radius, 0.0, 0.0]) for name, share in zip(ROBOTS, (-0.3, 0.3))}
    poses, happened, ways = dict(starts), [], []
    for k in range(1, steps + 1):
        motions, scans = [], []
        for name in ROBOTS:
            u = np.array([stride, 0.0, _turn(poses[name], stride, radius, rng)])
            poses[name] = pose = compose(poses[name], u)
            Q_k = stride * Q
            motions.append(Motion(name, k, rng.multivariate_normal(u, Q_k), Q_k))
            nearest = np.argsort(np.hypot(*(points - pose[:2]).T))[:observations]
            scans.append(_scan(name, k, pose, points, nearest, rng))
        happened.append((motions, scans))
        ways.append([*poses.values()])
    survey = _scan('r1', 0, starts['r1'], points, np.arange(landmarks), rng)
    return SyntheticDrive(starts, survey, happened, np.array(ways))


def _turn(pose: Array, stride: float, radius: float, rng: np.random.Generator) -> float:
    """Return by how much a robot turns: at random, but near the edge to the middle."""
    if np.hypot(*pose[:2]) > 0.9 * radius:
        middle = between(pose, np.zeros(3))
        return 0.3 * stride * float(np.sign(middle[1]))
    return float(rng.normal(0.0, 0.1 * np.sqrt(stride)))


def _scan(
    name: str, stamp: int, pose: Array, points: Array, seen: Indices, rng: np.random.Generator
) -> Scan:
    z = h(np.tile(pose, (len(seen), 1)), points[seen]) + rng.normal(0.0, SIGMA, (len(seen), 2))
    return Scan(name, stamp, tuple(Observation(int(k), z_k, R) for k, z_k in zip(seen, z)))
