# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The solution is the minimum of the weighted squares of all residuals."""

from dataclasses import replace
from itertools import pairwise
import pickle

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.optimize import least_squares

from fej_slam_ros.core import gauss_newton
from fej_slam_ros.core.gauss_newton import ConvergenceError, SingularError
from fej_slam_ros.core.smoothing import least_squares as smoothing
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, OdometryFactors, Values
from fej_slam_ros.core.smoothing.least_squares import information, solve
from fej_slam_ros.core.smoothing.problem import Problem
from helpers.core import central_differences, pose_difference, turn, wrapped
from helpers.smoothing import far_from, RENDEZVOUS, rendezvous_world, world

#: The iteration ends below 1e-9 m; a further step would be ten times smaller.
SAME = {'rtol': 0.0, 'atol': 1e-9}


def dead_reckoned(problem, truth):
    """Return poses by odometry from each true start, and landmarks at first observation."""
    poses, points = truth.poses.copy(), truth.points.copy()
    odometry, landmarks = problem.odometry, problem.landmarks
    for begin, end, u in zip(odometry.pose, odometry.target, odometry.z):
        poses[end] = poses[begin] + [*turn(poses[begin, 2]) @ u[:2], u[2]]
    for pose, landmark, z in reversed(list(zip(landmarks.pose, landmarks.target, landmarks.z))):
        points[landmark] = poses[pose, :2] + turn(poses[pose, 2]) @ z
    return Values(poses, points)


def whitened_residuals(problem, values):
    """Return all residuals of the cost, measurement by measurement."""
    odometry, landmarks, poses = problem.odometry, problem.landmarks, values.poses
    residuals = []
    for begin, end, u in zip(odometry.pose, odometry.target, odometry.z):
        p, phi = poses[begin, :2], poses[begin, 2]
        r = u - [*turn(-phi) @ (poses[end, :2] - p), poses[end, 2] - phi]
        r[2] = wrapped(r[2])
        residuals.append(np.linalg.inv(np.linalg.cholesky(odometry.R)) @ r)
    for pose, landmark, z in zip(landmarks.pose, landmarks.target, landmarks.z):
        r = z - turn(-poses[pose, 2]) @ (values.points[landmark] - poses[pose, :2])
        residuals.append(np.linalg.inv(np.linalg.cholesky(landmarks.R)) @ r)
    rendezvous = problem.rendezvous
    for pose, other, z in zip(rendezvous.pose, rendezvous.target, rendezvous.z):
        r = z - turn(-poses[pose, 2]) @ (poses[other] - poses[pose])[:2]
        residuals.append(np.linalg.inv(np.linalg.cholesky(rendezvous.R)) @ r)
    return np.concatenate(residuals)


def independent_minimum(problem, start):
    """Return the minimum and its cost by the dense solver of scipy with finite differences."""
    size = start.poses.size

    def values(x):
        poses = np.concatenate([start.poses[:1].ravel(), x[:size - 3]])
        return Values(poses.reshape(-1, 3), x[size - 3:].reshape(-1, 2))

    found = least_squares(
        lambda x: whitened_residuals(problem, values(x)),
        np.concatenate([start.poses[1:].ravel(), start.points.ravel()]), jac='3-point',
        xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return values(found.x), 2.0 * found.cost


def with_various_noise(factors, rng):
    """Return factors with standard deviations divided by up to a million in each coordinate."""
    scale = 10.0 ** rng.uniform(-6.0, 0.0, factors.z.shape)
    return replace(factors, R=scale[:, :, None] * factors.R * scale[:, None, :])


def assert_same(ours, theirs, **tolerance):
    assert_allclose(pose_difference(ours.poses, theirs.poses), 0.0, **tolerance)
    assert_allclose(ours.points, theirs.points, **tolerance)


@pytest.mark.parametrize('robots', [1, 2, 3])
def test_exact_measurements_give_the_truth_at_zero_cost(robots):
    problem, truth = world(seed=1, robots=robots, noise=0.0)

    solution = solve(problem, far_from(truth, seed=2))

    assert_same(solution.values, truth, **SAME)
    assert solution.cost < 1e-20  # the squares of rounding
    # With correct Jacobians each step squares the error: 1, 0.1, 1e-2, 1e-4, 1e-8, 1e-16.
    assert solution.iterations <= 8


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_the_minimum_equals_that_of_an_independent_solver(seed):
    problem, truth = world(seed, steps=6)

    solution = solve(problem, truth)

    expected, cost = independent_minimum(problem, truth)
    assert_same(solution.values, expected, rtol=0.0, atol=1e-6)  # differences of the other solver
    assert solution.cost == pytest.approx(cost, rel=1e-10)
    assert solution.unknowns == 3 * (2 * 7 - 1) + 2 * 5


@pytest.mark.parametrize('turns', [-1.0, 1.0])
@pytest.mark.parametrize('ends', [0.0, 2.0])
def test_a_turn_too_many_between_observed_poses_is_no_minimum(turns, ends):
    """Gross errors, removed later, can wind a trajectory; each increment resists a little."""
    count, step = 100, 0.02
    poses = np.column_stack([
        step * np.arange(count), np.zeros(count), np.linspace(0.0, ends, count)])
    points = np.array([[1.0, 2.0], [3.0, -1.0], [0.5, 1.0]])
    pairs = [(pose, landmark) for pose in (0, count - 1) for landmark in range(3)]
    u = np.array([
        [*turn(-a[2]) @ (b - a)[:2], wrapped((b - a)[2])] for a, b in pairwise(poses)])
    z = np.array([turn(-poses[k, 2]) @ (points[m] - poses[k, :2]) for k, m in pairs])
    problem = Problem(
        OdometryFactors(
            np.arange(count - 1), np.arange(1, count), u, np.diag([0.02, 0.02, 0.02]) ** 2),
        LandmarkFactors(*np.array(pairs).T, z, 0.005 ** 2 * np.eye(2)))
    wound = poses + turns * np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 2.0 * np.pi], count)
    wound[:, 2] = wrapped(wound[:, 2])

    solution = solve(problem, Values(wound, points))

    assert_same(solution.values, Values(poses, points), **SAME)
    assert solution.cost < 1e-15


def test_a_minimum_is_kept_if_none_is_found_without_its_turn():
    """A robot is turned by 4 rad while its wheels rest."""
    count, step = 12, 4.0 / 11
    poses = np.arange(count)[:, None] * [0.1, 0.0, step]
    points = np.array([[1.0, 2.0], [3.0, -1.0], [0.5, 1.0]])
    pairs = [(pose, landmark) for pose in (0, count - 1) for landmark in range(3)]
    z = np.array([turn(-poses[k, 2]) @ (points[m] - poses[k, :2]) for k, m in pairs])
    problem = Problem(
        OdometryFactors(
            np.arange(count - 1), np.arange(1, count), np.zeros((count - 1, 3)),
            np.diag([0.1, 0.1, 0.1]) ** 2),
        LandmarkFactors(*np.array(pairs).T, z, 0.05 ** 2 * np.eye(2)))
    turned, cost = independent_minimum(problem, Values(poses, points))

    # It takes two steps from this start, and more from that without the turn.
    solution = solve(problem, turned, max_iterations=3)

    assert_same(solution.values, turned, rtol=0.0, atol=1e-6)
    assert solution.cost == pytest.approx(cost, rel=1e-10)


@pytest.mark.parametrize('seed', [4, 5, 6])
def test_dead_reckoning_and_truth_lead_to_one_minimum(seed):
    problem, truth = world(seed)

    from_odometry, from_truth = (
        solve(problem, start) for start in (dead_reckoned(problem, truth), truth))

    assert_same(from_odometry.values, from_truth.values, **SAME)
    assert from_odometry.cost == pytest.approx(from_truth.cost, rel=1e-12)


def test_a_problem_that_was_solved_before_gives_the_bits_of_a_new_one():
    # What it keeps of the solution depends on nothing but the measurements.
    problem, truth = world(seed=7)
    start = far_from(truth, seed=8)
    information(problem, start, [2])
    solve(problem, start, tolerance=1e-3)

    again, new = (solve(instance, start) for instance in (problem, replace(problem)))
    P, P_new = (
        information(instance, again.values).joint([3], [1])
        for instance in (problem, replace(problem)))

    assert_array_equal(again.values.poses, new.values.poses)
    assert_array_equal(P, P_new)
    assert information(problem, again.values) is not information(problem, new.values)


def test_only_the_measurements_of_a_problem_are_sent_to_another_process():
    problem, truth = world(seed=7)
    before = pickle.dumps(problem)

    solve(problem, truth)

    assert pickle.dumps(problem) == before


def test_two_measurements_of_one_increment_give_their_weighted_mean():
    Q = np.array([np.diag([0.1, 0.2, 0.3]), [[0.2, 0.1, 0.0], [0.1, 0.3, 0.1], [0.0, 0.1, 0.1]]])
    u = np.array([[1.0, 0.5, 0.2], [1.2, 0.1, 0.4]])
    odometry = OdometryFactors(np.array([0, 0]), np.array([1, 1]), u, Q)
    landmarks = LandmarkFactors(np.array([0]), np.array([0]), np.array([[2.0, 3.0]]), np.eye(2))

    # With pose 0 at the origin the problem is linear.
    solution = solve(Problem(odometry, landmarks), Values(np.zeros((2, 3)), np.zeros((1, 2))))

    information = np.linalg.inv(Q)
    mean = np.linalg.solve(information.sum(axis=0), np.einsum('kij,kj->i', information, u))
    assert_allclose(solution.values.poses[1], mean, atol=1e-14)
    assert_allclose(solution.values.points, [[2.0, 3.0]], atol=1e-14)
    assert solution.iterations == 2  # the second step is zero


def test_moving_everything_rigidly_moves_the_solution_with_it():
    problem, truth = world(seed=7)
    t, alpha = np.array([30.0, -20.0]), 2.0

    def moved(values):
        positions, headings = values.poses[:, :2] @ turn(alpha).T + t, values.poses[:, 2] + alpha
        return Values(np.column_stack([positions, headings]), values.points @ turn(alpha).T + t)

    solution, moved_solution = solve(problem, truth), solve(problem, moved(truth))

    assert_same(moved_solution.values, moved(solution.values), **SAME)
    assert moved_solution.cost == pytest.approx(solution.cost, rel=1e-12)


def test_the_order_of_poses_landmarks_and_measurements_does_not_matter():
    problem, truth = world(seed=8)
    rng = np.random.default_rng(9)
    odometry, landmarks = problem.odometry, problem.landmarks
    of_poses = np.concatenate([[0], 1 + rng.permutation(len(truth.poses) - 1)])
    of_points, rows_u, rows_z = map(
        rng.permutation, map(len, (truth.points, odometry.z, landmarks.z)))
    place, slot = np.argsort(of_poses), np.argsort(of_points)

    mixed = solve(
        Problem(
            OdometryFactors(
                place[odometry.pose[rows_u]], place[odometry.target[rows_u]], odometry.z[rows_u],
                odometry.R),
            LandmarkFactors(
                place[landmarks.pose[rows_z]], slot[landmarks.target[rows_z]],
                landmarks.z[rows_z], landmarks.R)),
        Values(truth.poses[of_poses], truth.points[of_points])).values

    straight = solve(problem, truth).values
    assert_same(Values(mixed.poses[place], mixed.points[slot]), straight, **SAME)


def test_each_measurement_may_have_a_covariance_of_its_own():
    problem, truth = world(seed=10)
    odometry, landmarks = problem.odometry, problem.landmarks

    each = solve(
        Problem(
            replace(odometry, R=np.tile(odometry.R, (len(odometry.z), 1, 1))),
            replace(landmarks, R=np.tile(landmarks.R, (len(landmarks.z), 1, 1)))), truth)

    assert_same(each.values, solve(problem, truth).values, **SAME)


def test_a_factor_of_all_covariances_divides_the_cost_and_leaves_the_minimum():
    problem, truth = world(seed=11)
    odometry, landmarks = problem.odometry, problem.landmarks

    once = solve(problem, truth)
    larger = solve(Problem(
        replace(odometry, R=4.0 * odometry.R), replace(landmarks, R=4.0 * landmarks.R)), truth)

    assert_same(larger.values, once.values, **SAME)
    assert larger.cost == pytest.approx(once.cost / 4.0, rel=1e-12)


def test_with_the_right_covariances_the_cost_is_chi_square():
    dof = 30 + 2 * 5 * 11 - (30 + 2 * 5)  # ten increments, 55 observations, unknowns
    costs = [solve(*world(seed, robots=1)).cost for seed in range(100, 200)]

    # Standard deviation of the mean of 100: sqrt(2 / 100 / dof) = 0.014; three of them.
    assert np.mean(costs) / dof == pytest.approx(1.0, abs=0.042)


def test_pose_0_is_fixed():
    problem, truth = world(seed=12)

    values = solve(problem, truth).values

    assert_array_equal(values.poses[0], truth.poses[0])


def test_whole_turns_in_headings_do_not_matter():
    problem, truth = world(seed=13)
    odometry = problem.odometry
    turned = truth.poses + 2.0 * np.pi * np.arange(len(truth.poses))[:, None] * [0.0, 0.0, 1.0]

    values = solve(
        Problem(replace(odometry, z=odometry.z - [0.0, 0.0, 4.0 * np.pi]), problem.landmarks),
        Values(turned, truth.points)).values

    assert_same(values, solve(problem, truth).values, **SAME)
    assert np.all(np.abs(values.poses[:, 2]) <= np.pi)


def test_an_unobserved_landmark_is_an_error():
    problem, truth = world(seed=14)

    with pytest.raises(SingularError, match='do not determine all poses and landmarks'):
        solve(problem, Values(truth.poses, np.vstack([truth.points, [0.0, 0.0]])))


def test_an_iteration_that_does_not_end_is_an_error():
    problem, truth = world(seed=15)

    with pytest.raises(ConvergenceError, match='did not converge in 2 iterations'):
        solve(problem, far_from(truth, seed=16), max_iterations=2)


@pytest.mark.parametrize('name', RENDEZVOUS)
def test_rendezvous_poses_equal_those_of_gtsam(name):
    reference = pytest.importorskip('helpers.gtsam_reference', reason='gtsam is not installed')
    problem, truth = rendezvous_world(name, seed=17)

    solution = solve(problem, truth)

    expected = reference.Reference(problem, truth)
    assert_same(solution.values, expected, rtol=0.0, atol=1e-8)
    assert solution.cost == pytest.approx(expected.cost, rel=1e-10)


def test_exact_robot_observations_give_the_truth():
    met = [(0, 1, k) for k in range(6)]
    problem, truth = world(seed=18, noise=0.0, met=met, shared=False)

    solution = solve(problem, far_from(truth, seed=19))

    assert_same(solution.values, truth, **SAME)


def test_a_single_robot_observation_does_not_determine_the_heading():
    problem, truth = world(seed=21, shared=False, met=[(0, 1, 4)])

    with pytest.raises(SingularError, match='do not determine'):
        solve(problem, truth)


def test_all_fixed_poses_keep_their_values():
    problem, truth = world(seed=22)

    values = solve(replace(problem, fixed_poses=(3, 15)), truth).values

    assert_array_equal(values.poses[[3, 15]], truth.poses[[3, 15]])
    assert np.all(values.poses[0] != truth.poses[0])


def test_a_pose_fixed_at_the_minimum_does_not_change_it():
    problem, truth = world(seed=23, robots=1, steps=4)
    everything = solve(problem, truth).values

    held = replace(problem, fixed_poses=(0, 2))
    start = far_from(everything, seed=24)
    start.poses[2] = everything.poses[2]

    assert_same(solve(held, start).values, everything, **SAME)


def test_the_factor_of_a_small_step_is_used_again_without_a_change_of_the_minimum(monkeypatch):
    problem, truth = world(7)
    factors, new = [], smoothing.Cholesky
    monkeypatch.setattr(
        smoothing, 'Cholesky', lambda matrix: factors.append(matrix) or new(matrix))

    reusing = solve(problem, truth)
    reused = reusing.iterations - len(factors)
    monkeypatch.setattr(smoothing, 'MAX_REUSE_STEP', 0.0)
    factors.clear()
    newton = solve(replace(problem), truth)

    assert reused >= 1
    assert len(factors) == newton.iterations
    # Both end where the next step is below 1e-9.
    assert_same(reusing.values, newton.values, atol=1e-9)


def test_near_the_minimum_no_step_is_damped():
    problem, truth = world(seed=25)

    assert solve(problem, truth).rejected == 0


def test_damping_converges_where_gauss_newton_does_not(monkeypatch):
    problem, truth = world(seed=26, robots=1, landmarks=2)
    lost = far_from(truth, seed=5, metres=5.0)

    solution = solve(problem, lost)

    assert solution.rejected > 0
    assert_same(solution.values, solve(problem, truth).values, **SAME)
    monkeypatch.setattr(gauss_newton, 'COST_ROUNDING', np.inf)  # every step is taken
    with pytest.raises(ConvergenceError):
        solve(problem, lost)


def test_damping_ends_where_rounding_hides_the_gain_of_a_step():
    problem, truth = world(seed=26, robots=1)

    solution = solve(problem, far_from(truth, seed=17, metres=2.0))

    assert solution.rejected > 0
    assert_same(solution.values, solve(problem, truth).values, **SAME)


@pytest.mark.parametrize('seed', [3, 11, 93])
def test_the_iteration_ends_where_rounding_hides_whether_a_step_lowers_the_cost(seed):
    # Standard deviations from 0.1 um to 0.2 m, at coordinates of some metres.
    problem, truth = world(seed, robots=1, noise=1e-4)
    rng = np.random.default_rng(seed)
    problem = replace(
        problem, odometry=with_various_noise(problem.odometry, rng),
        landmarks=with_various_noise(problem.landmarks, rng))

    solution = solve(problem, far_from(truth, seed, metres=0.01))

    other = solve(problem, far_from(truth, seed + 1, metres=0.001))
    assert_same(solution.values, other.values, rtol=0.0, atol=1e-8)
    assert solution.cost == pytest.approx(other.cost, rel=1e-8)


def test_a_step_that_is_small_because_of_damping_is_not_the_last(monkeypatch):
    problem, truth = world(seed=26, robots=1, landmarks=2)
    monkeypatch.setattr(gauss_newton, 'MIN_DAMPING', 1e15)

    with pytest.raises(ConvergenceError):
        solve(problem, far_from(truth, seed=5, metres=5.0))


@pytest.mark.parametrize('seed', range(30, 34))
def test_inactive_damping_changes_no_bit(seed, monkeypatch):
    problem, truth = world(seed)
    start = dead_reckoned(problem, truth)
    damped = solve(problem, start)

    monkeypatch.setattr(gauss_newton, 'COST_ROUNDING', np.inf)  # every step is taken
    plain = solve(problem, start)

    assert damped.rejected == 0
    assert_array_equal(damped.values.poses, plain.values.poses)
    assert damped.cost == plain.cost


@pytest.mark.parametrize('measured', ['odometry', 'landmarks', 'rendezvous'])
def test_jacobians_equal_central_differences(measured):
    problem, truth = world(seed=28, met=[(0, 1, 2), (1, 0, 5)])
    kind = getattr(problem, measured)
    truth.poses[:, 2] = np.linspace(-np.pi, np.pi, len(truth.poses))
    x = np.concatenate([truth.poses.ravel(), truth.points.ravel()])

    def predicted(x):
        poses, points = np.split(x, [truth.poses.size])
        return -kind.linearize(Values(poses.reshape(-1, 3), points.reshape(-1, 2)))[1]

    H, _ = kind.linearize(truth)
    first, second = kind.nodes(len(truth.poses))
    expected = central_differences(predicted, x, lambda a, b: pose_difference(a, b) if (
        measured == 'odometry') else a - b)
    for k, (a, b) in enumerate(zip(first, second)):
        start = 3 * b if b < len(truth.poses) else truth.poses.size + 2 * (b - len(truth.poses))
        columns = [*range(3 * a, 3 * a + 3), *range(start, start + H.shape[2] - 3)]
        assert_allclose(H[k], expected[k][:, columns], atol=1e-8)  # rounding over the step
