# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots stay near their course, and odometry has the stated covariance."""

from itertools import pairwise
import math

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.geometry import between
from fej_slam_ros.sim.driving import drive, Leg, odometry

LEGS = (Leg(10, 0.0), Leg(12, math.pi), Leg(8, -1.0))
SIGMA = np.array([0.05, 0.02, 0.02])
#: The model refuses to have no noise at all.
HARDLY = np.full(3, 1e-9)
STAMPS = range(0, 31 * 500_000_000, 500_000_000)


def driven(sigma, seed=1, legs=LEGS):
    return drive(legs, np.asarray(sigma), np.random.default_rng(seed))


def increments(poses):
    return np.array([between(a, b) for a, b in pairwise(poses)])


def test_without_noise_a_leg_ends_where_its_arc_does():
    poses = driven(HARDLY, legs=[Leg(8, -math.pi / 2.0), Leg(4, 0.0)]).poses

    # 4 s at 0.5 m/s are a quarter of a circle of radius 4 / pi to the right; then 1 m on.
    r, right = 4.0 / math.pi, -math.pi / 2.0
    np.testing.assert_allclose(poses[8], [r, -r, right], atol=1e-7)  # of the noise
    np.testing.assert_allclose(poses[12], [r, -r - 1.0, right], atol=1e-7)


def test_odometry_without_noise_is_the_true_path():
    commands, poses = driven(HARDLY)

    recorded = [o.pose for o in odometry('p', commands, HARDLY, STAMPS)]

    np.testing.assert_allclose(recorded, poses, atol=1e-6)  # of the noise over 30 steps


def test_odometry_starts_at_its_own_origin_without_covariance():
    first = next(odometry('p', driven(SIGMA).commands, SIGMA, STAMPS))

    assert (first.robot, first.stamp, first.twist_covariance) == ('p', 0, None)
    np.testing.assert_array_equal(first.pose, np.zeros(3))


def test_odometry_errors_match_their_covariance():
    whitened = []
    for seed in range(200):
        commands, poses = driven(SIGMA, seed)
        recorded = [*odometry('p', commands, SIGMA, STAMPS)]
        errors = increments(poses) - increments([o.pose for o in recorded])
        errors[:, 2] = np.remainder(errors[:, 2] + math.pi, 2.0 * math.pi) - math.pi
        roots = np.linalg.cholesky([0.5**2 * o.twist_covariance for o in recorded[1:]])
        whitened.append(np.linalg.solve(roots, errors[:, :, None])[:, :, 0])
    samples = np.vstack(whitened)

    # Mean products of n independent standard normal pairs: five standard deviations, which are
    # sqrt(2 / n) at most; what the first order of eq. (10) leaves out is a hundredth of that.
    assert len(samples) == 200 * 30
    np.testing.assert_allclose(
        samples.T @ samples / len(samples), np.eye(3), atol=5.0 * math.sqrt(2.0 / len(samples)))


def test_commands_have_no_lateral_velocity():
    np.testing.assert_array_equal(driven(SIGMA).commands[:, 1], 0.0)


def test_steering_keeps_the_robot_near_its_course():
    ends = [driven(SIGMA, seed, [Leg(200, 0.0)]).poses[-1] for seed in range(50)]

    across = np.array(ends)[:, 1]
    # Unsteered, 100 m with 0.01 rad a step would end 0.01 x 0.25 x sqrt(200^3 / 3) = 4 m across.
    assert np.sum(across**2) < 0.2**2 * chi2.ppf(0.9999, 50)


@pytest.mark.parametrize('seed', [1, 2])
def test_the_same_seed_gives_the_same_drive(seed):
    one, other = driven(SIGMA, seed), driven(SIGMA, seed)

    np.testing.assert_array_equal(one.poses, other.poses)
    assert np.any(one.poses != driven(SIGMA, seed + 1).poses)
