# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares beside a filter at the same time, against runs that end at that time."""

import numpy as np
import pytest

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import NS, Odometry, RobotScan, Scan, TruePose
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.experiments.real_data.causal_least_squares import causal_least_squares
from fej_slam_ros.ros.session import simulation

SETTINGS = Settings((RobotSettings('r1', 1), RobotSettings('r2', 2)), 'r1')


def test_errors_are_those_of_runs_that_end_then():
    records = [*simulation.parse({'loops': 3, 'rate': 2.0, 'seed': 5}).records()]
    stamps = [record.stamp for record in records if isinstance(record, Odometry)]
    # The first record at or after 60 s is the last one that both know.
    last = next(k for k, record in enumerate(records) if record.stamp >= stamps[0] + 60 * NS)
    known = [
        record for record in records[:last + 1]
        if isinstance(record, (Odometry, Scan, RobotScan))]
    team, estimator = TeamSmoother(SETTINGS), Estimator(SETTINGS)
    for record in known:
        team.add(record)
        estimator.add(record)
    assert list(team.take())
    assert list(estimator.take())
    team.adopt(solve(team.task()))
    truth = {
        (record.robot, record.stamp): record.pose for record in records
        if isinstance(record, TruePose)}

    smoother, causal = causal_least_squares(SETTINGS, records)

    assert stamps[-1] < stamps[0] + 120 * NS
    assert causal.poses == 2
    newest = {name: trajectory.newest() for name, trajectory in team.trajectories.items()}
    for estimates, expected in (
            (newest, causal.least_squares),
            ({name: estimator.pose(name) for name in newest}, causal.filter)):
        errors = [
            estimate.pose - truth[name, estimate.stamp] for name, estimate in estimates.items()]
        # Smoothers that begin elsewhere end at increments of 1e-9 m.
        assert expected == pytest.approx(
            np.sqrt(np.mean([e[:2] @ e[:2] for e in errors])), abs=1e-7)
    assert causal.least_squares != causal.filter
    # At the end the smoother knows everything.
    last = max(trajectory.stamps[-1] for trajectory in smoother.trajectories.values())
    assert last == stamps[-1]
    assert smoother.solution.has_joined(['r1', 'r2'])
