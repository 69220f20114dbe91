# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relative poses of robots, with what both share cancelling."""

import numpy as np
from numpy.testing import assert_allclose

from fej_slam_ros.core.ekf.relative_pose import relative_pose
from helpers.core import central_differences, pose_difference, SmallTeam, turn


def in_frame_of(x):
    """Return the pose x[3:] in the base frame of the robot at x[:3]."""
    return np.array([*turn(x[2]).T @ (x[3:5] - x[:2]), x[5] - x[2]])


def estimated_team():
    team = SmallTeam(seed=5, robots=2, landmarks=4)
    filter_ = team.start('fej')
    for stamp in range(1, 6):
        team.step(filter_, stamp, team.names, team.names)
    return filter_.state


def test_a_relative_pose_has_the_covariance_of_first_order():
    state = estimated_team()
    robots = [state.robots['r1'], state.robots['r2']]
    x = np.concatenate([state.estimate(robot) for robot in robots])
    D = central_differences(in_frame_of, x, pose_difference)

    relative = relative_pose(state, 'r1', 'r2')

    assert_allclose(pose_difference(relative.pose, in_frame_of(x)), np.zeros(3), atol=1e-12)
    # Central differences are right to 1e-9.
    assert_allclose(relative.P, D @ state.marginal(robots) @ D.T, atol=1e-8)


def test_common_errors_of_both_robots_cancel():
    state = estimated_team()
    before = relative_pose(state, 'r1', 'r2').P
    every = state.variables()
    P = state.marginal(every)
    for variable in every:
        for other in every:
            i, j = variable.slot.start, other.slot.start
            P[i:i + 2, j:j + 2] += 100.0 * np.eye(2)

    state.covariance = type(state.covariance)()
    state.covariance.insert(P)

    assert_allclose(relative_pose(state, 'r1', 'r2').P, before, atol=1e-10)
