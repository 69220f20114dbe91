# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Times of batch least squares over all poses of a robot and all landmarks."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from fej_slam_ros.benchmark.machine import best
from fej_slam_ros.core.geometry import between, wrap_all
from fej_slam_ros.core.models import h
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, OdometryFactors, Values
from fej_slam_ros.core.smoothing.least_squares import information
from fej_slam_ros.core.smoothing.normal_equations import Cholesky
from fej_slam_ros.core.smoothing.problem import Problem

#: Size of the whole log of Victoria Park, which has 6.6 observations per pose.
LOG_POSES, LOG_LANDMARKS, LOG_OBSERVATIONS = 6899, 299, 7
#: Covariances of an increment and of an observation.
LOG_Q = np.diag([0.01, 0.01, 0.001]) ** 2
LOG_R = np.diag([0.1, 0.1]) ** 2


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
