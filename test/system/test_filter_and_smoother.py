# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The filter and the smoother agree on the same run."""

from collections import deque

import numpy as np
import pytest

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.sim.environments import ENVIRONMENTS
from helpers.core import wrapped
from helpers.slow import slow

TEAM = Settings((RobotSettings('r1', 1), RobotSettings('r2', 2)), 'r1', gate_probability=1.0)


@pytest.mark.parametrize('seed', [0, *map(slow, range(1, 4))])
@pytest.mark.parametrize('environment', ENVIRONMENTS)
def test_final_poses_of_the_filter_are_within_three_sigma_of_the_smoother(environment, seed):
    filter_, smoother = Estimator(TEAM), TeamSmoother(TEAM)
    for record in ENVIRONMENTS[environment].records(np.random.default_rng(seed)):
        filter_.add(record)
        smoother.add(record)
    for either in (filter_, smoother):
        deque(either.close(), maxlen=0)

    smoother.adopt(solve(smoother.task()))

    for name, way in smoother.trajectories.items():
        robot = filter_.groups.team.state.robots[name]
        smoothed, filtered = way.newest(), filter_.groups.team.state.estimate(robot)
        assert robot.stamp == smoothed.stamp
        assert smoothed.frame == 'map'
        difference = filtered - smoothed.pose
        difference[2] = wrapped(difference[2])
        assert (np.abs(difference) < 3.0 * np.sqrt(np.diag(smoothed.P))).all()
