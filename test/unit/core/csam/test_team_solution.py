# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Filters of robots continue correctly after a solution of their team."""

import numpy as np
from numpy.testing import assert_allclose

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from helpers.records import odometry, scan, team

LANDMARKS = np.random.default_rng(1).uniform(-8.0, 8.0, (9, 2))
#: The place of the same landmarks for the other robot, which reads one ID as that of another tag.
MISREAD = LANDMARKS + 3.0 * (np.arange(9) == 5)[:, None]


def driven(steps):
    """Return records of two robots side by side, 1 m apart, whose measurements are exact."""
    return [record for ms in 100 * steps for robot, points in (
        ('r1', LANDMARKS), ('r2', MISREAD - [0.0, 1.0])) for record in (
            odometry(robot, ms), scan(robot, ms, enumerate(points - [ms / 1000.0, 0.0])))]


def test_a_landmark_of_which_observations_were_left_out_does_not_correct_newest_poses():
    smoother = TeamSmoother(team(), solve_every=10_000)
    for record in driven(np.arange(60)):
        smoother.add(record)
    list(smoother.take())

    smoother.adopt(solve(smoother.task()))
    for record in driven(np.arange(60, 90)):
        smoother.add(record)
    newest = list(smoother.take())

    assert {o.landmark for left_out in smoother.solution.outliers.values() for o in left_out} == {
        ('', 5)}
    start = {'r1': [0.0, 0.0, 0.0], 'r2': [0.0, 1.0, 0.0]}
    for pose in newest:
        assert pose.frame == 'map'
        # All measurements are exact.
        true = start[pose.robot] + np.array([pose.stamp / 1e9, 0.0, 0.0])
        assert_allclose(pose.pose, true, rtol=0.0, atol=1e-6)
