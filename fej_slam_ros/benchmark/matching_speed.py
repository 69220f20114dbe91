# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time of associating a scan without landmark IDs with a large map."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from fej_slam_ros.benchmark.synthetic_drive import fej_filter
from fej_slam_ros.core.data_association.landmark_manager import LandmarkManager
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Motion, NO_ID, Observation, Scan
from fej_slam_ros.ros.session.percentiles import percentiles

SCAN_SIZE, MAP_SIZE, SCAN_COUNT = 20, 1000, 100
#: Covariance of the robot's pose, and of an observation with its standard deviation [m].
POSE_P = np.diag([0.2, 0.2, 0.02]) ** 2
SCAN_SIGMA = 0.1
SCAN_R = SCAN_SIGMA ** 2 * np.eye(2)


@dataclass(frozen=True)
class MatchingTime:
    """Times of associating a scan without landmark IDs [s]."""

    #: Number of observations in the scan, and of landmarks in the map.
    observations: int
    landmarks: int
    #: Over scans.
    median: float
    p99: float
    matched: float  #: Fraction of the observations that were associated correctly


def matching_time() -> MatchingTime:
    """Time the association of scans without landmark IDs."""
    rng = np.random.default_rng(1)
    team, points = _mapped_world(rng)
    team.predict(Motion('r1', 1, np.zeros(3), POSE_P))
    manager, times, matched = LandmarkManager(), [], 0
    nearest = np.argsort(np.hypot(*points.T))[:SCAN_SIZE]
    for k in range(SCAN_COUNT):
        z = points[nearest] + rng.normal(0.0, SCAN_SIGMA, (SCAN_SIZE, 2))
        scan = Scan('r1', k, tuple(Observation(NO_ID, z_k, SCAN_R) for z_k in z))
        begin = perf_counter()
        named = manager.associate(team, scan, 0.99)
        times.append(perf_counter() - begin)
        true_ids = {z_k.tobytes(): id_ for id_, z_k in zip(nearest.tolist(), z)}
        matched += sum(true_ids[s.z.tobytes()] == s.id for s in named.associated.observations)
    of_scans = percentiles(np.array(times))
    return MatchingTime(
        SCAN_SIZE, MAP_SIZE, of_scans.median, of_scans.p99, matched / (SCAN_COUNT * SCAN_SIZE))


def _mapped_world(rng: np.random.Generator) -> tuple[Filter, Array]:
    """Return a filter with all landmarks of a square in its map, and their true positions."""
    points = rng.uniform(-50.0, 50.0, (MAP_SIZE, 2))
    team = fej_filter(dict.fromkeys(('r1', 'r2'), np.zeros(3)), np.zeros((3, 3)))
    team.start_landmarks([
        Scan('r1', 0, tuple(Observation(k, point, SCAN_R) for k, point in enumerate(points)))])
    return team, points
