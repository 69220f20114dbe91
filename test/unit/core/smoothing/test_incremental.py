# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothing pose by pose equals batch smoothing in the end, and is accurate before."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.gauss_newton import ConvergenceError
from fej_slam_ros.core.geometry import between, compose, inverse, transform
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing import incremental as module
from fej_slam_ros.core.smoothing import newest_pose
from fej_slam_ros.core.smoothing.factors import OdometryFactors, Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother, NEVER
from fej_slam_ros.core.smoothing.least_squares import information, Solution, solve
from fej_slam_ros.core.smoothing.newest_pose import NearMarginal
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


@pytest.mark.parametrize('error', [0.0, 0.2])
def test_poses_after_an_unknown_motion_are_where_their_landmarks_are(error):
    """The batch minimum without any measurement of that motion."""
    team = SmallTeam(6, 1, 6)

    def driven(steps):
        smoother = IncrementalSmoother(team.look('r1').observations, module.NEVER)
        for k in steps:
            motion = team.drive('r1', k)
            smoother.add(motion.u, motion.Q, team.look('r1', observed_at(k, 6)).observations)
        return smoother

    first = driven(range(1, 16))
    team.drive('r1', 16)
    later = driven(range(17, 32))
    start = team.truth.pose('r1', 0)
    true = np.array([between(start, team.truth.pose('r1', k)) for k in range(32)])

    first.append(later, compose(true[16], np.full(3, error)))
    first.solve()

    problem, known = first.problem(), np.arange(31) != 15
    without = replace(problem, odometry=OdometryFactors(
        *(getattr(problem.odometry, name)[known] for name in ('pose', 'target', 'z', 'R'))))
    batch = solve(without, Values(true, first.values().points))
    # A turn of sigma pi weighs 2.5e-4 of one of 0.05, and is 0.2 rad off.
    assert_same(first.values(), batch.values, atol=1e-4)
    assert len(first) == 32
    assert first.covariances().shape == (31, 3, 3)


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


@pytest.mark.parametrize('solve_every', [1000, 9])
def test_the_newest_pose_and_its_covariance_are_those_of_batch_least_squares(solve_every):
    """With small errors all linearisations agree, those of the filter and of six solutions."""
    smoother, _, _ = grown(seed=3, steps=50, noise=1e-3, solve_every=solve_every)

    pose, P = smoother.pose, smoother.P

    batch = solve(smoother.problem(), smoother.values()).values
    expected = information(smoother.problem(), batch).joint([50])
    sigma = np.sqrt(np.diag(expected))
    # Errors are a thousandth of what the covariances state.
    assert_allclose(pose_difference(pose, batch.poses[-1]) / sigma, 0.0, atol=1e-4)
    assert_allclose(P / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=5e-3)


def test_the_newest_pose_is_consistent_between_solutions():
    runs = [grown(seed, steps=25, noise=0.5, solve_every=15) for seed in range(200)]

    errors = np.array([pose_difference(smoother.pose, true[-1]) for smoother, true, _ in runs])
    P = np.array([smoother.P for smoother, _, _ in runs])

    # Errors are half of what covariances state. The mean of 200 runs has a sigma of 0.06.
    assert nees_per_dof(2.0 * errors, P).mean() == pytest.approx(1.0, abs=0.18)


def test_observations_that_break_the_filter_wait_for_the_next_solution(monkeypatch):
    smoother, _, _ = grown(seed=9, steps=10, noise=1e-3)
    expected = compose(smoother.pose, np.array([1.0, 0.0, 0.1]))
    seen = [Observation(1, np.ones(2), np.eye(2)), Observation(77, np.ones(2), np.eye(2))]

    with monkeypatch.context() as broken:
        broken.setattr(Covariance, 'correction', raises(ArithmeticError('not definite')))
        smoother.add(np.array([1.0, 0.0, 0.1]), np.eye(3), seen)

    assert smoother.error == 'not definite'
    assert_allclose(smoother.pose, expected)
    assert [*smoother.problem().landmarks.pose[-2:]] == [11, 11]
    smoother.solve()
    smoother.add(np.zeros(3), np.eye(3), seen)
    assert smoother.error == ''


def raises(error):
    """Return a function of any arguments that raises an error."""
    def fail(*_):
        raise error
    return fail


def test_landmarks_far_from_the_last_solution_start_anew(monkeypatch):
    """A new landmark depends on the pose alone, so its first observation has no information."""
    monkeypatch.setattr(newest_pose, 'MAX_FILTER_LANDMARKS', 2)
    smoother, true, points = grown(seed=8, steps=30, noise=1e-3)
    smoother.solve()
    solved = smoother.values()
    at = dict(zip(smoother.landmark_index, solved.points))
    near, *_, far = sorted(at, key=lambda id_: np.linalg.norm(at[id_] - smoother.pose[:2]))
    P = [smoother.P]

    for id_ in (far, near):
        z = turn(true[-1][2]).T @ (points[id_] - true[-1][:2])
        smoother.add(np.zeros(3), 1e-12 * np.eye(3), [Observation(id_, z, 1e-4 * np.eye(2))])
        P.append(smoother.P)

    assert_allclose(P[1], P[0], rtol=0.0, atol=1e-8)
    assert np.linalg.det(P[2]) < 0.5 * np.linalg.det(P[0])
    assert_array_equal(smoother.values().points, solved.points)


def circling(seed, heading_sigma, poses, is_rich=False, **settings):
    """Return smoother and true poses of a circle of 314 m; if rich, with landmarks all along."""
    rng = np.random.default_rng(seed)
    Q, R = np.diag([0.05, 0.05, heading_sigma]) ** 2, 0.01 * np.eye(2)
    first = rng.uniform(-8.0, 8.0, (6, 2))
    smoother, true = IncrementalSmoother(**settings), [np.zeros(3)]
    for k in range(poses):
        u = np.array([1.0, 0.0, 2.0 * np.pi / 314])
        x = compose(true[-1], u)
        seen = {i: p for i, p in enumerate(first) if np.hypot(*(p - x[:2])) < 10.0}
        if is_rich:
            seen[100 + k] = transform(x, np.array([1.0, 2.0]))
        smoother.add(rng.multivariate_normal(u, Q), Q, [
            Observation(i, transform(inverse(x), p) + rng.normal(0.0, 0.1, 2), R)
            for i, p in seen.items()])
        true.append(x)
    return smoother, np.array(true)


def test_the_pose_is_consistent_after_a_long_loop_was_closed_between_solutions():
    """The heading has lost 0.9 rad by then; Jacobians at first estimates had a NEES/3 of 101."""
    nees = []
    for seed in range(12):
        smoother, true = circling(seed, 0.05, 325, solve_every=10_000)
        error = smoother.pose - true[-1]
        error[2] = (error[2] + np.pi) % (2.0 * np.pi) - np.pi
        nees.append(float(nees_per_dof(error, smoother.P)))

    # The mean of 12 has a sigma of 0.24.
    assert np.mean(nees) < 1.8


def test_the_filter_forgets_distant_landmarks_and_the_smoother_does_not(monkeypatch):
    monkeypatch.setattr(newest_pose, 'MAX_FILTER_LANDMARKS', 5)
    sizes = []
    update = Filter.update
    monkeypatch.setattr(Filter, 'update', lambda self, observations: (
        sizes.append(len(self.state.landmarks)), update(self, observations))[1])

    smoother, true = circling(1, 0.001, 60, is_rich=True, solve_every=10_000)

    # Twice as many as it continues with, and those of a scan.
    assert max(sizes) <= 2 * 5 + 7
    values = smoother.values()
    assert len(values.points) == len(smoother.landmark_index) > 60
    new = [k for id_, k in smoother.landmark_index.items() if id_ >= 100]
    expected = [transform(x, np.array([1.0, 2.0])) for x in true[1:]]
    assert_allclose(values.points[new], expected, atol=1.5)


def test_a_landmark_seen_late_from_a_pose_that_was_solved_for_is_where_it_was_seen():
    smoother, _, _ = grown(seed=5, steps=20, solve_every=1000)
    seen = Observation(99, np.array([2.0, 1.0]), np.eye(2))
    smoother.add(np.array([1.0, 0.2, 0.3]), 0.01 * np.eye(3), [seen])
    values = smoother.values()
    # As solved by another process that did not know the last scan yet.
    earlier = Values(values.poses, values.points[:-1])

    smoother.adopt(earlier, NearMarginal.of_pose(np.eye(3)))

    assert_array_equal(smoother.values().poses, values.poses)
    assert_allclose(
        smoother.values().points[-1], transform(values.poses[-1], seen.z), atol=1e-12)


def test_everything_is_solved_for_once_in_solve_every_poses_with_observations(monkeypatch):
    everything = []

    def spy(problem, start, *tolerance):
        solution = solve(problem, start, *tolerance)
        if len(start.poses) > 13:
            everything.append(len(start.poses))
        return solution

    monkeypatch.setattr(module.least_squares, 'solve', spy)
    grown(seed=4, steps=47, solve_every=15)

    # There is no observation from every seventh pose: 15 of the poses 1 to 17 have some.
    assert everything == [18, 35]


def test_the_time_between_full_solutions_grows_with_the_number_of_poses(monkeypatch):
    solved = []

    def unchanged(_, start, tolerance):
        assert tolerance == module.DUE_TOLERANCE
        solved.append(len(start.poses))
        return Solution(start, 0.0, 0, 0, 0)

    monkeypatch.setattr(module.least_squares, 'solve', unchanged)
    smoother = IncrementalSmoother(solve_every=5)
    for _ in range(200):
        smoother.add(np.array([1.0, 0.0, 0.0]), np.eye(3), [Observation(1, np.ones(2), np.eye(2))])

    steps = np.diff([1, *solved])
    # The fifth pose, until a tenth of all poses is more: from the one with number 60 on.
    assert steps[:11].tolist() == 11 * [5]
    assert (steps[11:] == np.array(solved[11:]) // 10).all()


def test_a_solution_that_failed_is_not_attempted_again_before_the_next_is_due(monkeypatch):
    attempts = []

    def failing(_, start, __):
        attempts.append(len(start.poses))
        raise ConvergenceError('no minimum')

    monkeypatch.setattr(module.least_squares, 'solve', failing)
    smoother = IncrementalSmoother(solve_every=5)
    for _ in range(30):
        with suppress(ConvergenceError):
            smoother.add(
                np.array([1.0, 0.0, 0.0]), np.eye(3), [Observation(1, np.ones(2), np.eye(2))])

    assert attempts == [6, 11, 16, 21, 26, 31]


def test_poses_after_an_adopted_solution_follow_from_it_as_from_one_of_its_own():
    own, adopting = (grown(seed=5, steps=20, solve_every=1000)[0] for _ in range(2))
    later = [
        (np.array([1.0, 0.2, 0.3]), 0.01 * np.eye(3), []),
        (np.array([1.0, 0.0, 0.3]), 0.01 * np.eye(3), [
            Observation(2, np.array([1.0, 1.0]), 0.01 * np.eye(2)),
            Observation(99, np.array([2.0, 1.0]), 0.01 * np.eye(2))])]
    values = own.solve().values
    near = NearMarginal.of(
        information(own.problem(), values), values, 20, np.arange(len(values.points)))
    for smoother in (own, adopting):
        for measured in later:
            smoother.add(*measured)

    adopting.adopt(values, near)

    # The same filter with the same input, but for the way in which the covariance was computed.
    assert_same(adopting.values(), own.values(), atol=1e-12)
    assert_allclose(adopting.P, own.P, rtol=1e-9)
    assert_allclose(adopting.covariances(), own.covariances()[-2:], rtol=1e-9)


def test_a_smoother_that_has_adopted_a_solution_leaves_solving_to_others(monkeypatch):
    smoother, _, _ = grown(seed=5, steps=10)
    smoother.adopt(smoother.values(), NearMarginal.of_pose(np.eye(3)))
    monkeypatch.delattr(module.least_squares, 'solve')

    for _ in range(module.SOLVE_EVERY + 10):
        smoother.add(np.ones(3), np.eye(3), [Observation(1, np.ones(2), np.eye(2))])

    assert len(smoother) == module.SOLVE_EVERY + 21


# Chi-square by GTSAM, started at X_GNI of the complete log.
@pytest.mark.slow
@pytest.mark.parametrize(('robot', 'expected'), [('r1', 77607.57633), ('r2', 73108.43132)])
def test_half_of_victoria_park_added_pose_by_pose_reaches_the_optimum(data, robot, expected):
    log = park.divide(park.read(park.find(data / 'fej_ekf_paper')), park.CAR_TEAMS[2])[robot]
    smoother = IncrementalSmoother(log.observations[0], solve_every=400)
    for u, observations in zip(log.increments, log.observations[1:]):
        smoother.add(u, park.ODOMETRY_Q, observations)

    assert smoother.solve().cost == pytest.approx(expected, rel=1e-6)


def test_the_covariance_after_an_unknown_motion_is_in_the_frame_of_the_map():
    smoother = IncrementalSmoother(solve_every=NEVER)
    smoother.add(np.array([1.0, 0.0, np.pi / 2]), 1e-12 * np.eye(3))
    # Ahead of the last pose is y of the map.
    smoother.append(
        IncrementalSmoother(), np.array([5.0, 0.0, 1.0]), np.diag(np.square([0.01, 1.0, 0.1])))

    assert_allclose(np.sqrt(np.diag(smoother.P)), [1.0, 0.01, 0.1], rtol=1e-6)


def test_a_smoother_that_never_solves_by_itself_does_not_when_another_is_appended(monkeypatch):
    smoother = IncrementalSmoother(solve_every=NEVER)
    monkeypatch.setattr(IncrementalSmoother, 'solve', None)

    smoother.append(IncrementalSmoother(), np.array([5.0, 0.0, 1.0]), np.eye(3))

    assert len(smoother) == 2
