# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted poses of simulated runs are consistent, though the settled poses come late."""

from collections import defaultdict

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.prediction import PosePredictor
from fej_slam_ros.core.records import NS, Odometry, TruePose
from fej_slam_ros.ros.session import simulation
from helpers.core import pose_difference
from helpers.records import team

#: Delay of the settled poses [s].
DELAY = 1.0


def mean_nees(seed, environment, **world):
    """Return the mean NEES/3 of the predicted poses in ``map`` of each robot in a run."""
    simulated = simulation.parse(
        {'environment': environment, 'seed': seed, 'loops': 1, 'range': 200.0, **world})
    estimator = Estimator(team(max_delay=DELAY, gate_probability=1.0))
    predictors = defaultdict(PosePredictor)
    truth, predicted, settled = {}, [], {}
    for record in simulated.records():
        if isinstance(record, TruePose):
            truth[record.robot, record.stamp] = record.pose
            continue
        estimator.add(record)
        if isinstance(record, Odometry):
            predictors[record.robot].add(record)
            predicted.append(predictors[record.robot].predict(estimator.robots[record.robot]))
            assert record.stamp - settled.get(record.robot, 0) >= DELAY * NS
        for result in estimator.take():
            for pose in result.poses:
                predictors[pose.robot].settle(pose, result.odometry[pose.robot])
                settled[pose.robot] = pose.stamp
    nees = defaultdict(list)
    for pose in predicted:
        if pose is not None and pose.frame == 'map':
            error = pose_difference(pose.pose, truth[pose.robot, pose.stamp])
            nees[pose.robot].append(error @ np.linalg.solve(pose.P, error) / 3)
    return {robot: np.mean(values) for robot, values in nees.items()}


def assert_consistent(environment, seeds, low, high, **world):
    runs = [mean_nees(seed, environment, **world) for seed in seeds]
    for robot in ('r1', 'r2'):
        assert low < np.mean([run[robot] for run in runs]) < high


def test_predictions_of_a_few_runs_are_in_the_band_of_chi_square():
    seeds = range(6)
    # As if all poses of a run were one: 3 degrees of freedom a run, 99.9 %.
    low, high = chi2.ppf([0.0005, 0.9995], 3 * len(seeds)) / (3 * len(seeds))

    assert_consistent('circles', seeds, low, high, landmarks=8, steps_per_loop=20)


@pytest.mark.slow
@pytest.mark.parametrize('environment', ['circles', 'figure_eight'])
def test_predictions_of_many_runs_have_a_nees_near_one(environment):
    assert_consistent(environment, range(60), 0.9, 1.2, landmarks=15)
