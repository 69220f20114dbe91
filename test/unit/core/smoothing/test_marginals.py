# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Covariances equal those of GTSAM and of dense algebra, and are consistent."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.sparse.linalg import splu

from fej_slam_ros.core.gauss_newton import SingularError
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing.factors import Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import information, solve
from fej_slam_ros.core.smoothing.problem import Problem
from helpers.smoothing import (
    observations_of_robots, RENDEZVOUS, rendezvous_world, whitened_dense, world)


def close(actual, expected):
    """Compare relative to the standard deviations."""
    sigma = np.sqrt(np.diagonal(expected, axis1=-2, axis2=-1))
    scale = sigma[..., :, None] * sigma[..., None, :]
    assert_allclose(actual / scale, expected / scale, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize('name', RENDEZVOUS)
def test_covariances_equal_those_of_gtsam(name):
    reference = pytest.importorskip('helpers.gtsam_reference', reason='gtsam is not installed')
    problem, truth = rendezvous_world(name, seed=1)
    theirs = reference.Reference(problem, truth)

    ours = information(problem, solve(problem, truth).values)

    poses, points = ours.marginals()
    for k in range(1, len(poses)):
        close(poses[k], theirs.covariance(reference.pose_key(k)))
    for k in range(len(points)):
        close(points[k], theirs.covariance(reference.landmark_key(k)))
    close(ours.joint([12, 3], [6, 0]), theirs.joint([12, 3], [6, 0]))


@pytest.mark.parametrize('name', RENDEZVOUS)
def test_all_marginals_at_once_equal_single_ones(name):
    problem, truth = rendezvous_world(name, seed=2)

    information_ = information(problem, truth)

    poses, points = information_.marginals()
    for k in range(1, len(poses)):
        close(poses[k], information_.joint([k]))
    for k in range(len(points)):
        close(points[k], information_.joint([], [k]))


def test_the_information_is_the_square_of_the_whitened_rows():
    problem, truth = world(seed=3, met=[(0, 1, 2), (1, 0, 4)])

    information_ = information(problem, truth)

    A = whitened_dense(problem, truth)[0][:, information_.coordinates]
    assert sorted(information_.coordinates) == list(range(3, truth.poses.size + truth.points.size))
    assert_allclose(information_.matrix.toarray(), A.T @ A, rtol=1e-12, atol=1e-9)


def test_the_square_root_is_upper_triangular_with_the_information_as_its_square():
    problem, truth = world(seed=4)
    information_ = information(problem, truth)

    R_sqrt, coordinates = information_.square_root()

    A = whitened_dense(problem, truth)[0][:, coordinates]
    dense = R_sqrt.toarray()
    assert_array_equal(dense, np.triu(dense))
    assert_allclose(dense.T @ dense, A.T @ A, rtol=1e-12, atol=1e-9)


def test_the_square_root_is_as_sparse_as_in_the_order_of_superlu():
    problem, truth = world(seed=15, robots=3, landmarks=20, steps=100)
    information_ = information(problem, truth)

    R_sqrt, _ = information_.square_root()

    theirs = splu(
        information_.matrix, permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0,
        options={'SymmetricMode': True})
    assert R_sqrt.nnz < 1.1 * theirs.U.nnz


@pytest.mark.parametrize(('poses', 'points'), [
    ([*range(1, 22)], [*range(5)]), ([21], [3, 0]), ([9, 4], [2]), ([], [1])])
def test_a_joint_covariance_equals_the_dense_inverse(poses, points):
    information_ = information(*world(seed=8))

    P = information_.joint(poses, points)

    columns = [
        *(3 * pose + k for pose in poses for k in range(3)),
        *(66 + 2 * point + k for point in points for k in range(2))]
    rows = [list(information_.coordinates).index(column) for column in columns]
    expected = np.linalg.inv(information_.matrix.toarray())[np.ix_(rows, rows)]
    # The eigenvalues span four orders of magnitude.
    assert_allclose(P, expected, rtol=1e-9, atol=1e-12)


def test_fixed_poses_have_zero_covariance():
    problem, truth = world(seed=7)
    information_ = information(replace(problem, fixed_poses=(0, 5)), truth)

    poses, points = information_.marginals()

    assert_array_equal(poses[[0, 5]], 0.0)
    joint = information_.joint([5, 6], [2])
    assert_array_equal(joint[:3], 0.0)
    close(joint[3:6, 3:6], poses[6])
    close(joint[6:, 6:], points[2])


def test_marginals_do_not_depend_on_the_order_of_poses():
    problem, truth = world(seed=8, met=[(0, 1, k) for k in range(11)])
    straight, _ = information(problem, truth).marginals()
    mix = np.concatenate([[0], 1 + np.random.default_rng(9).permutation(len(truth.poses) - 1)])
    place = np.argsort(mix)
    odometry, landmarks, rendezvous = problem.odometry, problem.landmarks, problem.rendezvous

    mixed, _ = information(
        Problem(
            replace(odometry, pose=place[odometry.pose], target=place[odometry.target]),
            replace(landmarks, pose=place[landmarks.pose]),
            replace(
                rendezvous, pose=place[rendezvous.pose],
                target=place[rendezvous.target])),
        Values(truth.poses[mix], truth.points)).marginals()

    close(mixed[place][1:], straight[1:])


def test_covariances_of_odometry_add_up():
    k, Q = 40, np.diag([0.1, 0.2, 0.0001])
    u = np.tile([1.0, 0.0, 0.0], (k, 1))
    smoother = IncrementalSmoother()
    for step in u:
        smoother.add(step, Q)

    poses, points = information(smoother.problem(), smoother.values()).marginals()

    # On a straight line x and heading add up; each heading error contributes to y to the end.
    assert_allclose(poses[k, 0, 0], k * 0.1)
    assert_allclose(poses[k, 2, 2], k * 0.0001)
    assert_allclose(poses[k, 1, 1], k * 0.2 + 0.0001 * sum((k - i) ** 2 for i in range(1, k + 1)))
    assert points.shape == (0, 2, 2)


def test_landmarks_observed_from_a_fixed_pose_have_the_covariance_of_the_observations():
    R = np.array([[0.04, 0.01], [0.01, 0.02]])
    observations = (
        Observation(7, np.array([3.0, 1.0]), R), Observation(9, np.array([1.0, -2.0]), 2.0 * R))

    smoother = IncrementalSmoother(observations)
    poses, points = information(smoother.problem(), smoother.values()).marginals()

    assert_array_equal(poses, np.zeros((1, 3, 3)))
    assert_allclose(points, [R, 2.0 * R])


def test_joint_covariance_is_consistent():
    nees = []
    for seed in range(100, 200):
        problem, truth = world(seed, robots=1, steps=5)
        values = solve(problem, truth).values
        P = information(problem, values).joint(range(1, 6), range(5))
        e = np.concatenate([(values.poses - truth.poses)[1:].ravel(),
                            (values.points - truth.points).ravel()])
        e[2:15:3] = np.arctan2(np.sin(e[2:15:3]), np.cos(e[2:15:3]))
        nees.append(e @ np.linalg.solve(P, e) / len(e))

    # Standard deviation of the mean of 100 with 25 degrees of freedom: 0.028; three of them.
    assert np.mean(nees) == pytest.approx(1.0, abs=0.085)


def test_an_unobserved_landmark_has_no_information():
    problem, truth = world(seed=10)

    with pytest.raises(SingularError, match='do not determine'):
        information(problem, Values(truth.poses, np.vstack([truth.points, [0.0, 0.0]])))


@pytest.mark.parametrize('seed', range(40, 50))  # rounding leaves small pivots, positive at 42
def test_unconnected_robots_have_no_information(seed):
    problem, truth = world(seed, shared=False)

    with pytest.raises(SingularError, match='do not determine'):
        information(problem, truth)


@pytest.mark.parametrize('end', [2, 3, 4, 8])
def test_a_robot_observation_may_connect_any_two_poses(end):
    problem, truth = world(seed=13, robots=1)
    R = np.diag([0.01, 0.02])
    met = observations_of_robots([(1, end)], truth, R, np.random.default_rng(14), R)

    information_ = information(replace(problem, rendezvous=met), truth)

    for pose, P in list(enumerate(information_.marginals()[0]))[1:]:
        close(P, information_.joint([pose]))


def test_an_accurate_robot_observation_determines_the_position():
    problem, truth = world(seed=11, robots=1, steps=2)
    R = np.diag([1e-12, 1e-12])
    met = observations_of_robots([(0, 2)], truth, R, np.random.default_rng(12), R)

    poses, _ = information(Problem(problem.odometry, problem.landmarks, met), truth).marginals()

    assert_allclose(np.sqrt(np.diag(poses[2])[:2]), 1e-6, rtol=1e-3)
