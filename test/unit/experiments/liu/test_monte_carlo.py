# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A run's errors are those of its estimates and depend on its task only."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.experiments.liu.monte_carlo import Errors, MonteCarloTask, simulate, stack
from fej_slam_ros.sim.environments import ENVIRONMENTS
from fej_slam_ros.sim.sensors import measure
from fej_slam_ros.sim.world import make_world

STEPS = 63
START = (30.0, -20.0, 3.14)
FILTERS = ('standard', 'ideal', 'fej')


def task(*seed, filters=FILTERS):
    """Return a run of one loop from far off, whose headings begin and end on the edge of pi."""
    environment = ENVIRONMENTS['circles']
    settings = replace(environment.world, landmarks=12, loops=1, start=START)
    world = make_world(settings, np.random.default_rng(1))
    return MonteCarloTask(world, environment.sensors, filters, seed)


def estimated(run, name):
    """Return the estimator, and the steps, of a filter over what the run measures."""
    estimator = Estimator(Settings(
        (RobotSettings('r1', 1), RobotSettings('r2', 2)), anchor='r1', anchor_pose=START,
        gate_probability=1.0, filter=name))
    for record in measure(run.world, run.sensors, np.random.default_rng(run.seed)):
        estimator.add(record)
    return estimator, list(estimator.close())


def assert_same(a, b):
    assert a.poses.keys() == b.poses.keys()
    for robot, steps in a.poses.items():
        assert_array_equal(steps, b.poses[robot])
    assert_array_equal(a.landmarks, b.landmarks)


@pytest.fixture(scope='module')
def run():
    return simulate(task(1, 2, 3))


@pytest.mark.parametrize('name', FILTERS)
def test_pose_errors_add_up_to_the_estimators_own_evaluation(run, name):
    estimator, _ = estimated(task(1, 2, 3), name)

    for robot, score in estimator.evaluation.scores.items():
        position, heading, nees = run[name].poses[robot].sum(axis=1)
        # Rounding of sums of squares.
        assert np.sqrt(position / (STEPS + 1)) == pytest.approx(score.position_rmse(), rel=1e-12)
        assert np.sqrt(heading / (STEPS + 1)) == pytest.approx(score.heading_rmse(), rel=1e-12)
        assert nees / score.with_nees == pytest.approx(score.mean_nees_per_dof(), rel=1e-9)


@pytest.mark.parametrize('name', FILTERS)
@pytest.mark.parametrize(('i', 'robot', 'first'), [(0, 'r1', 1), (1, 'r2', 0)])
def test_pose_errors_are_those_of_each_step(run, name, i, robot, first):
    _, steps = estimated(task(1, 2, 3), name)
    poses = [step.poses[i] for step in steps[first:]]
    e = np.array([pose.pose for pose in poses]) - task().world.true_poses[robot][first:]
    e[:, 2] = np.arctan2(np.sin(e[:, 2]), np.cos(e[:, 2]))

    nees = [e_k @ np.linalg.inv(pose.P) @ e_k / 3 for e_k, pose in zip(e, poses)]
    expected = [e[:, 0] ** 2 + e[:, 1] ** 2, e[:, 2] ** 2, nees]
    # P is inverted; rounding of headings.
    assert_allclose(run[name].poses[robot], expected, rtol=1e-9, atol=1e-14)


@pytest.mark.parametrize('name', FILTERS)
def test_map_errors_are_those_of_the_last_step_by_id(run, name):
    state = estimated(task(1, 2, 3), name)[0].groups.team.state

    expected = []
    for id_, point in task().world.landmarks.items():
        landmark = state.landmarks['', id_]
        e, P = state.estimate(landmark) - point, state.marginal([landmark])
        expected.append([e @ e, e @ np.linalg.inv(P) @ e / 2])

    assert_allclose(run[name].landmarks, np.transpose(expected), rtol=1e-9)  # P is inverted


def test_only_the_exactly_known_start_of_the_first_robot_is_excluded(run):
    for errors in run.values():
        assert errors.poses['r1'].shape == (3, STEPS)
        assert errors.poses['r2'].shape == (3, STEPS + 1)
        assert (errors.poses['r1'][:, 0] > 0.0).all()


def test_heading_errors_go_the_short_way_round(run):
    _, steps = estimated(task(1, 2, 3), 'fej')
    headings = np.array([step.poses[1].pose[2] for step in steps])
    assert np.ptp(headings - task().world.true_poses['r2'][:, 2]) > 6.0

    assert run['fej'].poses['r2'][1].max() < 0.5**2


def test_the_same_task_gives_the_same_bits(run):
    again = simulate(task(1, 2, 3))

    for name in FILTERS:
        assert_same(again[name], run[name])


@pytest.mark.parametrize('seed', [(1, 2, 4), (2, 2, 3)])
def test_another_number_or_seed_gives_other_noise(run, seed):
    other = simulate(task(*seed, filters=('fej',)))['fej']

    assert (other.poses['r2'][0] != run['fej'].poses['r2'][0]).all()


def test_the_result_of_a_filter_does_not_depend_on_the_other_filters(run):
    for name in FILTERS:
        assert_same(simulate(task(1, 2, 3, filters=(name,)))[name], run[name])


def test_filters_differ(run):
    errors = [run[name].poses['r2'][0] for name in FILTERS]

    assert all((a != b).any() for a, b in pairwise(errors))


def test_stacked_runs_keep_their_order():
    runs = [Errors({'r1': np.full((3, 4), k), 'r2': np.full((3, 5), -k)}, np.full((2, 6), k))
            for k in range(3)]

    stacked = stack(runs)

    assert stacked.poses['r1'].tolist() == [[4 * [k]] * 3 for k in range(3)]
    assert stacked.poses['r2'].tolist() == [[5 * [-k]] * 3 for k in range(3)]
    assert stacked.landmarks.tolist() == [[6 * [k]] * 2 for k in range(3)]
