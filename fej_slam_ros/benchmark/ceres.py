# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batch least squares by Ceres, where its Debian package and a compiler are installed."""

from pathlib import Path
import subprocess

import numpy as np

from fej_slam_ros.benchmark.batch import MAX_ITERATIONS, RELATIVE_DECREASE, TimedSolution
from fej_slam_ros.benchmark.cpp_program import built, can_build
from fej_slam_ros.core.smoothing.factors import concatenated, Factors, Values, whitener
from fej_slam_ros.core.smoothing.problem import Problem
from fej_slam_ros.errors import UserError

SOURCE = Path(__file__).with_name('ceres_batch.cpp')
HEADERS = Path('/usr/include/ceres')


def is_installed() -> bool:
    """Return whether the program can be built."""
    return can_build(HEADERS)


def solve(problem: Problem, start: Values) -> TimedSolution:
    """Return the minimum that Ceres reaches, with automatic derivatives."""
    poses, points = start.poses, start.points
    odometry, landmarks = concatenated(problem.odometry), concatenated(problem.landmarks)
    first, = problem.fixed_poses
    counts = [
        MAX_ITERATIONS, first, len(poses), len(points), len(odometry.z), len(landmarks.z)]
    given = b''.join([
        np.array(RELATIVE_DECREASE).tobytes(), np.array(counts, '<i8').tobytes(),
        poses.tobytes(), points.tobytes(), _rows(odometry), _rows(landmarks)])
    with built(SOURCE, [], ['ceres', 'glog']) as program:
        ended = subprocess.run(  # noqa: S603 - own arguments only
            [program], input=given, check=False, capture_output=True)
    reply = np.dtype([
        ('seconds', '<f8'), ('iterations', '<i8'), ('poses', '<f8', poses.shape),
        ('points', '<f8', points.shape)])
    if len(ended.stdout) != reply.itemsize:
        raise UserError(f'Ceres ended with status {ended.returncode}')
    (found,) = np.frombuffer(ended.stdout, reply)
    return TimedSolution(
        Values(found['poses'].copy(), found['points'].copy()), float(found['seconds']),
        int(found['iterations']))


def _rows(factors: Factors) -> bytes:
    """Return pose, target, z and whitener of each factor."""
    m, d = factors.z.shape
    rows = np.empty(m, [('nodes', '<i8', 2), ('z', '<f8', d), ('whitener', '<f8', (d, d))])
    rows['nodes'] = np.column_stack([factors.pose, factors.target])
    rows['z'], rows['whitener'] = factors.z, whitener(factors.R)
    return rows.tobytes()
