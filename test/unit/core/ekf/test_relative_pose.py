# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Relative poses of robots, with what both share cancelling."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.ekf.relative_pose import relative_pose
from helpers.core import central_differences, pose_difference, SmallTeam, turn, unknown_place

KINDS = ['standard', 'fej', 'invariant']


def in_frame_of(x):
    """Return the pose x[3:] in the base frame of the robot at x[:3]."""
    return np.array([*turn(x[2]).T @ (x[3:5] - x[:2]), x[5] - x[2]])


def estimated_team(kind):
    """Return the filter of a team, and the values of the states that it linearises at."""
    team = SmallTeam(seed=5, robots=2, landmarks=4)
    filter_ = team.start(kind)
    for stamp in range(1, 6):
        team.step(filter_, stamp, team.names, team.names)
    state = filter_.state
    return filter_, state.x_first if kind == 'fej' else state.x_hat


@pytest.mark.parametrize('kind', KINDS)
def test_a_relative_pose_has_the_covariance_of_first_order(kind):
    filter_, x_lin = estimated_team(kind)
    state = filter_.state
    robots = [state.robots['r1'], state.robots['r2']]
    x = np.concatenate([state.estimate(robot) for robot in robots])
    x_lin = np.concatenate([x_lin[robot.slot.indices] for robot in robots])
    D = central_differences(in_frame_of, x_lin, pose_difference)

    relative = relative_pose(state, filter_.linearization, 'r1', 'r2')

    assert (relative.observer, relative.observed) == ('r1', 'r2')
    assert_allclose(pose_difference(relative.pose, in_frame_of(x)), np.zeros(3), atol=1e-12)
    # Central differences are right to 1e-9.
    assert_allclose(relative.P, D @ state.marginal(robots) @ D.T, atol=1e-8)


@pytest.mark.parametrize('kind', KINDS)
def test_common_errors_of_both_robots_cancel(kind):
    filter_, x_lin = estimated_team(kind)
    state = filter_.state
    before = relative_pose(state, filter_.linearization, 'r1', 'r2').P
    unknown = unknown_place(state, x_lin, (10.0, 10.0, 0.5))
    P = state.marginal(state.variables()) + unknown

    state.covariance = type(state.covariance)()
    state.covariance.insert(P)

    after = relative_pose(state, filter_.linearization, 'r1', 'r2').P
    assert_allclose(after, before, atol=1e-10)
