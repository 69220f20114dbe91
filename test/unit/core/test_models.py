# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motion and observation models against hand-worked cases and central differences."""

from math import pi

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core import models
from fej_slam_ros.core.geometry import between
from helpers.core import central_differences, pose_difference, quarter_turn, turn

#: Error of central_differences, rounding / step + step^2, for lengths of order 10.
TOLERANCE = 1e-8

HEADINGS = [0.0, 1.0, -2.2, pi, pi - 1e-7, 1e-7 - pi]


def pose(phi):
    return np.array([3.0, -2.0, phi])


def test_motion_is_in_the_frame_of_the_pose():
    x = models.f(np.array([1.0, 2.0, pi / 2]), np.array([3.0, 1.0, pi / 4]))

    assert_allclose(x, [0.0, 5.0, 3 * pi / 4], atol=1e-15)


@pytest.mark.parametrize('turned', [0.2, -0.2])
def test_motion_wraps_the_heading_at_pi(turned):
    x = models.f(np.array([0.0, 0.0, np.sign(turned) * 3.1]), np.array([0.0, 0.0, turned]))

    assert_allclose(x[2], np.sign(turned) * (3.3 - 2 * pi), atol=1e-15)


def test_an_observation_is_in_the_base_frame():
    poses = np.array([[1.0, 2.0, pi / 2], [0.0, 0.0, pi]])
    points = np.array([[1.0, -1.0], [3.0, 1.0]])

    assert_allclose(models.h(poses, points), [[-3.0, 0.0], [-3.0, -1.0]], atol=1e-15)


@pytest.mark.parametrize('phi', HEADINGS)
def test_transition_and_noise_jacobian_are_derivatives_of_the_motion(phi):
    x, u = pose(phi), np.array([1.2, 0.3, 0.4])

    by_pose = central_differences(lambda x: models.f(x, u), x, pose_difference)
    by_motion = central_differences(lambda u: models.f(x, u), u, pose_difference)

    assert_allclose(models.Phi(turn(phi) @ u[:2]), by_pose, atol=TOLERANCE)
    assert_allclose(models.G(phi), by_motion, atol=TOLERANCE)


@pytest.mark.parametrize('phi', HEADINGS)
def test_the_observation_jacobian_is_the_derivative_of_the_observation(phi):
    at = np.array([*pose(phi), 7.0, 4.0])

    expected = central_differences(lambda v: models.h(v[None, :3], v[None, 3:])[0], at)

    assert_allclose(models.H(at[None, :3], at[None, 3:])[0], expected, atol=TOLERANCE)


@pytest.mark.parametrize('phi', HEADINGS)
def test_the_jacobian_of_an_observed_pose_is_the_derivative_of_between(phi):
    at = np.array([*pose(phi), 7.0, 4.0, 2.5])

    expected = central_differences(lambda v: between(v[:3], v[3:]), at, pose_difference)

    assert_allclose(models.H_pose(at[None, :3], at[None, 3:])[0], expected, atol=TOLERANCE)


def test_stacked_observation_jacobians_equal_single_ones():
    rng = np.random.default_rng(2)
    poses, points = rng.uniform(-3.0, 3.0, (5, 3)), rng.uniform(-9.0, 9.0, (5, 2))

    one_by_one = [models.H(p[None], f[None])[0] for p, f in zip(poses, points)]

    np.testing.assert_array_equal(models.H(poses, points), one_by_one)


@pytest.mark.parametrize('phi', HEADINGS)
def test_the_jacobian_of_a_new_landmark_is_the_derivative_of_its_position(phi):
    z = np.array([4.0, -1.0])

    expected = central_differences(lambda x: x[:2] + turn(x[2]) @ z, pose(phi))

    assert_allclose(models.F(turn(phi) @ z), expected, atol=TOLERANCE)


def test_a_rigid_motion_of_the_whole_world_is_unobservable():
    x, f, d = pose(0.5), np.array([7.0, 4.0]), np.array([1.0, 2.0])
    shift = np.tile(np.eye(2), (2, 1))
    H = models.H(x[None], f[None])[0]

    assert_allclose(H[:, [0, 1, 3, 4]] @ shift, np.zeros((2, 2)), atol=1e-15)
    rotation = np.array([*quarter_turn(x[:2]), 1.0, *quarter_turn(f)])
    assert_allclose(H @ rotation, np.zeros(2), atol=1e-14)
    rotated = models.Phi(d) @ np.array([*quarter_turn(x[:2]), 1.0])
    assert_allclose(rotated, [*quarter_turn(x[:2] + d), 1.0], atol=1e-14)
