# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Poses without observations are eliminated without a change of the solution."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.gauss_newton import SingularError
from fej_slam_ros.core.geometry import compose
from fej_slam_ros.core.records import UNKNOWN_POSE_COVARIANCE
from fej_slam_ros.core.smoothing import odometry_chains
from fej_slam_ros.core.smoothing.chain_reduction import ChainedIncrements
from fej_slam_ros.core.smoothing.factors import Values
from fej_slam_ros.core.smoothing.least_squares import information, solve
from fej_slam_ros.core.smoothing.odometry_chains import OdometryChains
from helpers.smoothing import far_from, whitened_dense, world


def sparse_world(seed, offset=0.0, observed_from=(4, 5, 13, 28, 33, 59)):
    """Return two robots of 30 steps; landmarks are observed from a few poses only."""
    problem, truth = world(seed, steps=30, met=[(0, 1, 8), (1, 0, 20)])
    kept = np.isin(problem.landmarks.pose, observed_from)
    landmarks = replace(
        problem.landmarks, pose=problem.landmarks.pose[kept],
        target=problem.landmarks.target[kept], z=problem.landmarks.z[kept])
    shift = [offset, offset, 0.0]
    return replace(problem, landmarks=landmarks), Values(
        truth.poses + shift, truth.points + offset)


@pytest.fixture(params=[5, 16_384], autouse=True)
def parts(request, monkeypatch):
    """Linearise chains in many parts, or all at once."""
    monkeypatch.setattr(odometry_chains, 'MAX_PART', request.param)


@pytest.mark.parametrize('offset', [0.0, 1e6], ids=['near the origin', 'at UTM coordinates'])
def test_the_solution_is_a_minimum_over_all_poses(offset):
    problem, truth = sparse_world(1, offset)

    solution = solve(problem, truth)

    A, b = whitened_dense(problem, solution.values)
    free = slice(3, None)
    # The gradient of the cost, against that of a millimetre.
    gradient = A[:, free].T @ b
    assert np.abs(gradient).max() < 1e-6 * np.abs(A[:, free].T @ A[:, free]).max() * 1e-3
    assert solution.cost == pytest.approx(b @ b, rel=1e-9)
    assert solution.unknowns == A.shape[1] - 3


def test_a_far_start_reaches_the_minimum_of_the_truth():
    problem, truth = sparse_world(2)

    near, far = solve(problem, truth), solve(problem, far_from(truth, 3, 0.3))

    assert_allclose(far.values.poses, near.values.poses, atol=1e-7)
    assert far.rejected > 0 or far.iterations > near.iterations


def test_the_covariances_are_those_of_all_poses():
    problem, truth = sparse_world(4)

    poses, points = information(problem, truth, kept=()).marginals()

    A, _ = whitened_dense(problem, truth)
    P = np.zeros((A.shape[1], A.shape[1]))
    P[3:, 3:] = np.linalg.inv(A[:, 3:].T @ A[:, 3:])
    for k, of_pose in enumerate(poses):
        assert_allclose(of_pose, P[3 * k:][:3, 3 * k:][:, :3], rtol=1e-7, atol=1e-10)
    for k, of_point in enumerate(points, start=3 * len(poses) // 2):
        assert_allclose(of_point, P[2 * k:][:2, 2 * k:][:, :2], rtol=1e-7, atol=1e-10)


def test_an_eliminated_pose_has_no_joint_covariance():
    problem, truth = sparse_world(5)

    with pytest.raises(ValueError, match='keep it'):
        information(problem, truth, kept=()).joint([2])

    assert_allclose(
        information(problem, truth, kept=[2]).joint([2]), information(problem, truth).joint([2]),
        rtol=1e-9)


@pytest.mark.parametrize('variance', [1e-6, 1e-13])
def test_the_covariance_of_a_chain_does_not_depend_on_those_before_it(variance):
    u, poses = np.tile([0.1, 0.0, 0.05], (20, 1)), np.zeros((21, 3))
    for k in range(20):
        poses[k + 1] = compose(poses[k], u[k])
    Q = np.tile(variance * np.eye(3), (20, 1, 1))
    Q[5] = UNKNOWN_POSE_COVARIANCE
    is_end = np.isin(np.arange(21), [0, 10, 20])

    def last_covariance(rows):
        begins = np.arange(20)[rows]
        chains = OdometryChains.of(begins, begins + 1, is_end | (np.arange(21) < begins[0]))
        return ChainedIncrements.of(chains, u[rows], Q[rows]).reduced(poses).covariances[-1]

    assert_array_equal(last_covariance(slice(None)), last_covariance(slice(10, None)))


@pytest.mark.filterwarnings('error')
def test_an_increment_whose_covariance_has_been_rounded_to_zero_determines_nothing():
    chains = OdometryChains.of(
        np.array([0, 1]), np.array([1, 2]), np.array([True, False, False]))

    with pytest.raises(SingularError, match='rounding makes the covariance of odometry singular'):
        ChainedIncrements.of(chains, np.zeros((2, 3)), np.array([np.eye(3), np.zeros((3, 3))]))
