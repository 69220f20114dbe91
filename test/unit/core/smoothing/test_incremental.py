# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothing pose by pose equals batch smoothing in the end, and is accurate before."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.geometry import between, transform
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing import incremental as module
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import information, solve, Values
from fej_slam_ros.datasets.victoria_park import associated_log as park
from helpers.core import pose_difference, SmallTeam, turn


def grown(seed, steps=30, landmarks=6, noise=1.0, **settings):
    """Return the smoother of a robot, its true poses and the true landmarks."""
    team = SmallTeam(seed, 1, landmarks, noise)
    smoother = IncrementalSmoother(team.look('r1').observations, **settings)
    for k in range(1, steps + 1):
        motion = team.drive('r1', k)
        smoother.add(motion.u, motion.Q, team.look('r1', observed_at(k, landmarks)).observations)
    start = team.truth.pose('r1', 0)
    true = np.array([between(start, team.truth.pose('r1', k)) for k in range(steps + 1)])
    points = {
        id_: turn(start[2]).T @ (point - start[:2])
        for id_, point in team.truth.landmarks.items()}
    return smoother, true, points


def observed_at(step, landmarks):
    """Return the landmarks observed at a step: two in turn, none at every seventh step."""
    return [] if step % 7 == 0 else [step % landmarks, (step + 1) % landmarks]


def assert_same(ours, theirs, atol):
    assert_allclose(pose_difference(ours.poses, theirs.poses), 0.0, atol=atol)
    assert_allclose(ours.points, theirs.points, rtol=0.0, atol=atol)


@pytest.mark.parametrize('solve_every', [1, 7, 1000])
def test_the_final_solution_equals_the_batch_minimum(solve_every):
    smoother, true, points = grown(seed=1, solve_every=solve_every)

    solution = smoother.solve()

    by_index = [points[id_] for id_ in smoother.landmark_index]
    batch = solve(smoother.problem(), Values(true, np.array(by_index)))
    assert_same(smoother.values(), batch.values, atol=1e-9)
    assert solution.cost == pytest.approx(batch.cost, rel=1e-12)


def test_exact_measurements_give_the_true_poses_at_every_step():
    smoother, true, points = grown(seed=2, noise=0.0)

    values = smoother.values()

    assert_allclose(pose_difference(values.poses, true), 0.0, atol=1e-9)
    for id_, number in smoother.landmark_index.items():
        assert_allclose(values.points[number], points[id_], atol=1e-9)


def test_between_solutions_the_newest_pose_is_better_than_dead_reckoning():
    runs = [grown(seed, steps=40, solve_every=1000) for seed in range(10, 20)]

    errors = [(smoother.values().poses[-1] - true[-1])[:2] for smoother, true, _ in runs]

    # Variance of odometry after 40 steps [m^2], without the effect of headings.
    assert np.mean(np.sum(np.square(errors), axis=1)) < 0.5 * 40 * 0.025


def test_adding_a_pose_solves_for_a_bounded_window(monkeypatch):
    sizes = []

    def spy(problem, start, *tolerance):
        sizes.append(len(start.poses))
        return solve(problem, start, *tolerance)

    monkeypatch.setattr(module.least_squares, 'solve', spy)
    grown(seed=3, steps=60, solve_every=1000)

    assert max(sizes) == module.WINDOW_POSES + 1


def test_everything_is_solved_for_once_in_solve_every_poses_with_observations(monkeypatch):
    everything = []

    def spy(problem, start, *tolerance):
        solution = solve(problem, start, *tolerance)
        if len(problem.fixed_landmarks) == 0 and len(start.poses) > 13:
            everything.append(len(start.poses))
        return solution

    monkeypatch.setattr(module.least_squares, 'solve', spy)
    grown(seed=4, steps=47, solve_every=15)

    # There is no observation from every seventh pose: 15 of the poses 1 to 17 have some.
    assert everything == [18, 35]


def test_the_time_between_full_solutions_grows_with_the_number_of_poses(monkeypatch):
    solved = []
    monkeypatch.setattr(
        IncrementalSmoother, 'solve', lambda self: solved.append(len(self.values().poses)))
    monkeypatch.setattr(IncrementalSmoother, '_solve_window', lambda self: None)

    smoother = IncrementalSmoother(solve_every=5)
    for _ in range(200):
        smoother.add(np.array([1.0, 0.0, 0.0]), np.eye(3), [Observation(1, np.ones(2), np.eye(2))])
        if solved and solved[-1] == len(smoother.values().poses):
            smoother.adopt(smoother.values())

    steps = np.diff([1, *solved])
    # The fifth pose, until a tenth of all poses is more: from the one with number 60 on.
    assert steps[:11].tolist() == 11 * [5]
    assert (steps[11:] == np.array(solved[11:]) // 10).all()


def test_adopted_values_move_later_poses_and_landmarks():
    smoother, _, _ = grown(seed=5, steps=20, solve_every=1000)
    before, problem = smoother.values(), smoother.problem()
    elsewhere = solve(problem, before).values
    u, Q = np.array([1.0, 0.2, 0.3]), 0.01 * np.eye(3)
    smoother.add(u, Q)
    smoother.add(u, Q, [Observation(99, np.array([2.0, 1.0]), 0.01 * np.eye(2))])
    relative = between(smoother.values().poses[20], smoother.values().poses[22])

    smoother.adopt(elsewhere)

    after = smoother.values()
    assert_same(Values(after.poses[:21], after.points[:-1]), elsewhere, atol=1e-14)
    assert_allclose(between(after.poses[20], after.poses[22]), relative, atol=1e-12)
    assert_allclose(after.points[-1], transform(after.poses[22], np.array([2.0, 1.0])), atol=1e-9)


def test_information_equals_that_of_the_complete_problem():
    smoother, _, _ = grown(seed=6)

    poses, points = smoother.information().marginals()

    expected = information(smoother.problem(), smoother.values()).marginals()
    assert_allclose(poses, expected[0])
    assert_allclose(points, expected[1])


# Chi-square by GTSAM, started at X_GNI of the complete log.
@pytest.mark.slow
@pytest.mark.parametrize(('robot', 'expected'), [('r1', 77607.57633), ('r2', 73108.43132)])
def test_half_of_victoria_park_added_pose_by_pose_reaches_the_optimum(data, robot, expected):
    log = park.divide(park.read(park.find(data / 'fej_ekf_paper')), park.CAR_TEAMS[2])[robot]
    smoother = IncrementalSmoother(log.observations[0], solve_every=400)
    for u, observations in zip(log.increments, log.observations[1:]):
        smoother.add(u, park.ODOMETRY_Q, observations)

    assert smoother.solve().cost == pytest.approx(expected, rel=1e-6)
