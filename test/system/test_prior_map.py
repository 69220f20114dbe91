# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks that are known before locate robots, and are known no better than they were."""

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import PriorMap, TrueLandmarks
from fej_slam_ros.core.settings import RobotSettings, Settings
from helpers.core import circles, estimate, turn
from helpers.records import odometry, scan
from helpers.slow import slow

TEAM = (RobotSettings('r1', 1), RobotSettings('r2', 2))
#: Longer than wide and correlated.
SURVEY = np.array([[0.04, 0.01], [0.01, 0.02]])
POINTS = {1: (4.0, 0.0), 2: (0.0, 5.0), 3: (-3.0, 2.0)}
ORIGIN = (0.0, 0.0, 0.0)


def survey(points, P=SURVEY, rng=None):
    """Return a prior map of points, each with the covariance P and an error of it."""
    errors = 0.0 if rng is None else rng.multivariate_normal(np.zeros(2), P, len(points))
    return PriorMap(
        tuple(points), np.array([*points.values()]) + errors, np.kron(np.eye(len(points)), P))


def run(records, prior, **settings):
    """Return an estimator that began with a prior map and was given the records."""
    estimator = Estimator(Settings(TEAM, **{'anchor': 'r1', **settings}), prior)
    for record in records:
        estimator.add(record)
    list(estimator.close())
    return estimator


def sees(robot, ms, pose, numbers):
    """Return the exact scan of surveyed points from a pose."""
    C = turn(pose[2])
    return scan(robot, ms, [(i, C.T @ (np.array(POINTS[i]) - pose[:2])) for i in numbers])


@pytest.mark.parametrize('anchor', [slow('r1'), ''])
def test_in_a_surveyed_map_poses_are_more_accurate_and_consistent(anchor):
    nees, errors = [], {'survey': [], 'none': []}
    for seed in range(50):
        records = circles(seed, landmarks=30)
        truth = next(r for r in records if isinstance(r, TrueLandmarks)).positions
        prior = survey(truth, rng=np.random.default_rng([seed, 1]))
        surveyed = run(records, prior, anchor=anchor, gate_probability=1.0).evaluation.scores
        alone, _ = estimate(records, gate_probability=1.0)
        nees.append([surveyed[name].mean_nees_per_dof() for name in ('r1', 'r2')])
        for scores, kind in ((surveyed, 'survey'), (alone.evaluation.scores, 'none')):
            errors[kind].append([scores[name].position_rmse() for name in ('r1', 'r2')])

    # 50 runs of 64 steps gave 1.00 to 1.02; the mean of 50 independent steps would be within 0.11.
    assert (np.abs(np.mean(nees, axis=0) - 1.0) < 0.15).all()
    assert (np.mean(errors['survey'], axis=0) < 0.3 * np.mean(errors['none'], axis=0)).all()


def test_prior_landmarks_are_not_initialized_again():
    pose = (1.0, 1.0, 0.5)
    estimator = run([
        odometry('r1', 0), odometry('r2', 0), sees('r1', 0, ORIGIN, POINTS),
        sees('r2', 0, pose, POINTS)], survey(POINTS, 100.0 * SURVEY))

    state = estimator.groups.team.state
    assert {key: mark.owner for key, mark in state.landmarks.items()} == {
        ('', number): '' for number in POINTS}
    for number, point in POINTS.items():
        landmark = state.landmarks['', number]
        np.testing.assert_array_equal(state.first_estimate(landmark), point)
        # What the exactly known anchor has seen is known by the noise of its observation.
        assert np.linalg.eigvalsh(state.marginal([landmark])).max() < 0.01


@pytest.mark.parametrize('seen', [[2, 3], [1, 2, 3]])
def test_at_step_0_a_robot_is_located_by_prior_landmarks_alone(seen):
    pose = (1.0, 1.0, 0.5)

    estimator = run([
        odometry('r1', 0), odometry('r2', 0),
        scan('r1', 0, [(9, (3.0, 3.0))]), sees('r2', 0, pose, seen)], survey(POINTS))

    state = estimator.groups.team.state
    np.testing.assert_allclose(state.estimate(state.robots['r2']), pose, atol=1e-9)


def test_without_an_anchor_robots_join_by_the_prior_map():
    poses = {'r1': (2.0, -1.0, 1.0), 'r2': (1.0, 1.0, 0.5)}
    records = [record for name, pose in poses.items() for record in (
        odometry(name, 0), sees(name, 0, pose, POINTS))]

    estimator = run(records, survey(POINTS, 1e-4 * SURVEY), anchor='')

    state = estimator.groups.team.state
    assert estimator.groups.not_in_map == {}
    for name, pose in poses.items():
        np.testing.assert_allclose(state.estimate(state.robots[name]), pose, atol=1e-9)


def test_without_an_anchor_a_robot_with_too_few_landmarks_is_reported():
    estimator = run(
        [odometry('r1', 0), sees('r1', 0, (2.0, -1.0, 1.0), [1])], survey(POINTS), anchor='')

    assert estimator.groups.not_in_map['r1'] == '1 shared landmark, needs 3'


def test_cross_covariances_of_the_prior_map_are_kept():
    # Both were surveyed from one place that is known to 10 m.
    P = np.kron(np.ones((2, 2)), 100.0 * np.eye(2)) + 1e-4 * np.eye(4)
    prior = PriorMap((1, 2), np.array([POINTS[1], POINTS[2]]), P)

    estimator = run([odometry('r1', 0), sees('r1', 0, ORIGIN, [1])], prior)

    state = estimator.groups.team.state
    # The observed landmark corrects the other: observations have 0.01, the two differ by 2e-4 m^2.
    assert np.diag(state.marginal([state.landmarks['', 2]])).max() < 0.011


def test_a_landmark_that_moved_since_the_survey_is_recognised():
    # Ten observations, the first and the last more than 2 m apart.
    records = [record for ms in range(0, 2500, 250) for record in (
        odometry('r1', ms), sees('r1', ms, (ms / 1000.0, 0.0, 0.0), POINTS))]

    estimator = run(records, survey({**POINTS, 2: (0.0, 9.0)}))

    assert estimator.groups.moved_landmarks() == [('', 2)]
