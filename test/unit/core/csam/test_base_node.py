# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of [Andersson]: the base node of two maps, or the reason for a failure."""

from dataclasses import replace
import re

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.optimize import least_squares as scipy_least_squares

from fej_slam_ros.core.csam import base_node, maps
from fej_slam_ros.core.csam.base_node import (
    align, RendezvousObservations, square_root_information)
from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.csam.rendezvous import RendezvousMeasurement
from fej_slam_ros.core.gauss_newton import ConvergenceError, SingularError
from fej_slam_ros.core.geometry import between, compose
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.smoothing.factors import (
    LandmarkFactors, OdometryFactors, stacked, Values)
from fej_slam_ros.core.smoothing.problem import Problem
from helpers.core import turn
from helpers.csam import in_another_frame, Met, R_ROBOT, rendezvous_of, true_base_node

#: Probability with which correct observations are accepted.
ACCEPTED = 1.0 - 1e-6
ONE_WAY = [(0, 1, k) for k in range(3, 9)]


def aligned(team, maps=None):
    return align(*rendezvous_of(maps or team.maps, team.measurements))


@pytest.mark.parametrize('met', [
    ONE_WAY, [(1, 0, k) for k in range(3, 9)], [(0, 1, 4), (1, 0, 4)], [(0, 1, 4), (1, 0, 9)],
    [(0, 1, 0), *ONE_WAY]])
def test_exact_measurements_give_the_true_base_node(met):
    team = Met(1, met, noise=0.0)

    found = aligned(team)

    # The smoother stops within 1e-9, over 12 poses.
    assert_allclose(found.base_node.pose, true_base_node(team, 'r1', 'r2'), atol=1e-7)
    assert found.dof == 2 * len(met) - 3
    assert found.chi_square < 1e-6


def test_each_observation_is_one_of_its_own_poses():
    team, measurements = Met(2, [], noise=0.0), []
    # The second map has them in the opposite order.
    for k, (a, b) in enumerate([(3, 8), (6, 5), (9, 2)]):
        x, y = team.true_poses['r1'][a], team.true_poses['r2'][b]
        z = turn(x[2]).T @ (y - x)[:2]
        measurements.append(RendezvousMeasurement('r1', a, 'r2', b, z, R_ROBOT, k))

    found = align(*rendezvous_of(team.maps, measurements))

    assert_allclose(found.base_node.pose, true_base_node(team, 'r1', 'r2'), atol=1e-7)


@pytest.mark.parametrize('poses', [[5], [0, 4], [4, 0, 9], [3, 5, 8, 11]])
def test_information_derived_from_that_of_the_map_equals_that_of_the_poses(poses):
    joint = JointMap.of(Met(2, ONE_WAY).maps[0])
    kept = joint.information(range(len(joint.values.poses)))

    exact, derived = (
        joint.rendezvous_information(np.array(poses), information) for information in (None, kept))

    assert (derived.middle, derived.start) == (exact.middle, exact.start)
    assert_array_equal(derived.poses, exact.poses)
    # Variances of 1e-4 are differences of variances of 1e-2.
    size = np.abs(exact.R_sqrt).max(initial=0.0)
    assert_allclose(derived.R_sqrt, exact.R_sqrt, rtol=0.0, atol=1e-10 * size)


def test_poses_far_from_the_start_are_certain_of_each_other_all_the_same(monkeypatch):
    joint = JointMap.of(Met(2, ONE_WAY).maps[0])
    kept, poses = joint.information(range(len(joint.values.poses))), np.array([3, 5, 8])
    exact = joint.rendezvous_information(poses)

    monkeypatch.setattr(maps, 'MIN_RELATIVE_VARIANCE', 1e8)  # no digit would be left

    assert_array_equal(joint.rendezvous_information(poses, kept).R_sqrt, exact.R_sqrt)


def whole_linear_map(local, middle):
    """Return mean and A with A^T A = P^-1 of all poses and landmarks in the frame of a pose."""
    centred = JointMap.of(local).in_frame_of(middle)
    n, points = len(centred.values.poses), len(centred.values.points)
    others = [k for k in range(n) if k != middle]
    P = centred.information().joint(poses=others, points=range(points))
    return centred.values, others, np.linalg.inv(np.linalg.cholesky(P))


def test_base_node_equals_that_of_the_complete_linear_maps():
    team = Met(2, ONE_WAY)
    middle = team.measurements[3].pose
    (of_p, others, A_p), (of_q, _, A_q) = (
        whole_linear_map(local, middle) for local in team.maps)
    size, k = len(A_p), 3 * len(others)

    def residuals(x):
        moved, b = (x[:size], x[size:2 * size]), x[2 * size:]
        poses = []
        for values, dx in zip((of_p, of_q), moved):
            at = values.poses.copy()
            at[others] += dx[:k].reshape(-1, 3)
            poses.append(at)
        observed = [
            np.linalg.cholesky(np.linalg.inv(met.R)).T @ (
                met.z - between(poses[0][met.pose], compose(b, poses[1][met.observed_pose]))[:2])
            for met in team.measurements]
        return np.concatenate([A_p @ moved[0], A_q @ moved[1], *observed])

    start = np.zeros(2 * size + 3)
    start[-3:] = between(team.true_poses['r1'][middle], team.true_poses['r2'][middle])
    x = scipy_least_squares(residuals, start, method='lm', xtol=1e-15, ftol=1e-15, gtol=1e-15).x

    found = aligned(team)

    starts = of_p.poses[0] + x[:3], of_q.poses[0] + x[size:size + 3]
    expected = between(starts[0], compose(x[-3:], starts[1]))
    assert_allclose(found.base_node.pose, expected, atol=1e-6)
    assert found.chi_square == pytest.approx(np.sum(np.square(residuals(x))), rel=1e-6)


@pytest.mark.parametrize('reach', [30.0, 1000.0])
def test_base_node_does_not_depend_on_the_frames(monkeypatch, reach):
    monkeypatch.setattr(base_node, 'MAX_ALIGNMENT_ITERATIONS', 10)
    rng = np.random.default_rng(3)
    team = Met(4, [*ONE_WAY, (1, 0, 5)])
    expected = aligned(team).base_node
    for _ in range(50):
        frame = rng.uniform([-reach, -reach, -np.pi], [reach, reach, np.pi])

        found = aligned(team, [team.maps[0], in_another_frame(team.maps[1], frame)])

        # A heading error of 1e-12 at 1 km is 1e-9.
        assert_allclose(compose(found.base_node.pose, frame), expected.pose, atol=1e-8)


def test_position_covariance_grows_with_the_distance_to_the_origin():
    team = Met(5, ONE_WAY)
    near = aligned(team).base_node
    far = aligned(team, [
        team.maps[0], in_another_frame(team.maps[1], np.array([100.0, 0.0, 0.0]))]).base_node

    across = np.array([-np.sin(far.pose[2]), np.cos(far.pose[2])])

    assert far.P[2, 2] == pytest.approx(near.P[2, 2], rel=1e-6)
    # Heading error times distance; the position sigma at r2's start is some centimetres.
    assert across @ far.P[:2, :2] @ across == pytest.approx(1e4 * near.P[2, 2], rel=0.1)


@pytest.mark.slow
def test_base_node_is_consistent():
    nees = []
    for seed in range(100):
        team = Met(1000 + seed, ONE_WAY, steps=8, landmarks=3)
        node = aligned(team).base_node
        error = node.pose - true_base_node(team, 'r1', 'r2')
        error[2] = np.arctan2(np.sin(error[2]), np.cos(error[2]))
        nees.append(error @ np.linalg.solve(node.P, error))

    # 300 degrees of freedom: three sigma of the mean are 3 sqrt(2 / 300) = 0.25.
    assert np.mean(nees) / 3 == pytest.approx(1.0, abs=0.25)


def test_one_observation_is_not_enough():
    failure = aligned(Met(6, [(0, 1, 4)]))

    assert failure == JoinFailure('not enough observations: 1 of the 2 that are needed')


def test_neither_of_two_observations_can_be_tested():
    # Side by side at their starts, which no error of the maps displaces.
    with np.errstate(all='raise'):
        found = aligned(Met(1, [(0, 1, 0), (1, 0, 0)]))

    assert_array_equal(found.d2, 0.0)


def by_odometry(poses, sigma):
    """Return the information of a map of odometry only about all its poses."""
    increments = stacked(OdometryFactors, [
        (k, k + 1, between(*poses[k:k + 2]), sigma**2 * np.eye(3)) for k in range(len(poses) - 1)])
    problem = Problem(increments, stacked(LandmarkFactors, ()))
    local = LocalMap('', problem, Values(poses, np.zeros((0, 2))), ())
    return JointMap.unsolved(local).rendezvous_information(np.arange(len(poses)))


@pytest.mark.parametrize('sigma', [1e-2, 1e-6, 1e-10])
def test_the_observation_that_determines_the_heading_alone_is_not_taken_for_the_outlier(sigma):
    # r1 drives around r2, which stands, as its odometry knows, and only at the end drives on.
    along, rows = np.linspace(0.0, 3.0, 21), np.arange(21)
    around = np.column_stack([3.0 * np.cos(along), 3.0 * np.sin(along), along + np.pi / 2.0])
    standing = np.zeros((21, 3))
    standing[-1, 0] = 15.0
    p, q = by_odometry(around, 1e-3), by_odometry(standing, sigma)
    z = np.array([turn(a[2]).T @ (b - a)[:2] for a, b in zip(around, standing)])
    z[4, 0] += 0.8

    with np.errstate(all='raise'):
        found = [
            align(p, q, RendezvousObservations(
                rows, rows, np.ones(21, bool),
                z + 0.1 * np.random.default_rng(seed).normal(size=z.shape),
                np.tile(0.01 * np.eye(2), (21, 1, 1))))
            for seed in range(20)]

    assert [np.argmax(alignment.d2) for alignment in found] == [4] * 20


def test_observations_at_one_position_do_not_determine_the_heading():
    team = Met(7, ONE_WAY)
    p, q, observations = rendezvous_of(team.maps, team.measurements)
    # All observations are of one pose of r2 from one pose of r1.
    at_one = replace(
        observations, p=0 * observations.p, q=0 * observations.q, z=0 * observations.z)

    failure = align(p, q, at_one)

    assert re.match(r'cannot align: .* 0\.0 sigma, 15 are needed', failure.reason)


def test_information_that_leaves_poses_undetermined_has_no_minimum():
    # Of another robot, whose messages may say anything.
    p, q, observations = rendezvous_of((team := Met(7, ONE_WAY)).maps, team.measurements)

    with pytest.raises(ConvergenceError):
        align(p, replace(q, R_sqrt=0.0 * q.R_sqrt), observations)


def test_outliers_are_inconsistent_with_the_maps():
    team = Met(8, ONE_WAY)
    p, q, observations = rendezvous_of(team.maps, team.measurements)
    # Half of the observations have an error of half a metre, 25 sigma.
    with_outliers = replace(
        observations, z=observations.z + [[0.5, 0.0], [0.0, 0.0]] * 3)

    found = align(p, q, with_outliers)

    failure = JoinRules(probability=ACCEPTED).inconsistency(found.chi_square, found.dof)
    assert re.match(r'inconsistent \(chi-square \d+\.\d with 9 deg', failure.reason)


def test_a_singular_covariance_has_no_square_root_information():
    with pytest.raises(SingularError):
        square_root_information(np.ones((2, 2)))
