# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Increments from velocities and Cartesian from polar observations, with covariances."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.integrate import solve_ivp

from fej_slam_ros.core.motion_models import constant_turn, polar
from fej_slam_ros.errors import UserError
from helpers.core import central_differences, moments, turn

SIGMA = np.array([0.05, 0.02, 0.03])
#: Left, right, almost straight, straight, nearly a full turn, both sides of the series limit.
SPEEDS = [
    (0.5, 0.1, 0.8), (0.5, 0.1, -0.8), (1.0, -0.2, 1e-9), (1.0, 0.3, 0.0), (0.2, 0.0, 12.0),
    (0.7, 0.2, 0.0999), (0.7, 0.2, 0.1001), (0.0, 0.0, 0.5), (0.7, 0.2, 1e-4)]
T = 0.5


def driven(u, T=T):
    """Return the pose after T by numerical integration of the velocities."""
    def velocity(_t, x):
        return [*turn(x[2]) @ u[:2], u[2]]

    return solve_ivp(velocity, (0.0, T), np.zeros(3), rtol=1e-12, atol=1e-13).y[:, -1]


@pytest.mark.parametrize('u', SPEEDS)
def test_the_increment_equals_the_integrated_velocities(u):
    U, _ = constant_turn(np.array(u), SIGMA, T)

    assert_allclose(U, driven(u), rtol=0.0, atol=1e-11)  # of the integration


@pytest.mark.parametrize('u', SPEEDS)
def test_the_covariance_equals_the_propagated_velocity_noise(u):
    G = central_differences(driven, np.array(u), step=1e-4)

    _, Q = constant_turn(np.array(u), SIGMA, T)

    # Error of the integration over the step, times sigma squared.
    assert_allclose(Q, G @ np.diag(SIGMA**2) @ G.T, rtol=0.0, atol=1e-9)


def test_without_rotation_the_motion_is_straight():
    U, Q = constant_turn(np.array([2.0, 0.0, 0.0]), SIGMA, T)

    # d y / d omega = v T^2 / 2.
    G = np.array([[T, 0.0, 0.0], [0.0, T, 2.0 * T**2 / 2.0], [0.0, 0.0, T]])
    assert_allclose(U, [1.0, 0.0, 0.0], atol=1e-15)
    assert_allclose(Q, G @ np.diag(SIGMA**2) @ G.T, rtol=1e-14, atol=1e-18)


@pytest.mark.parametrize('theta', [1e-12, 1e-8, 1e-5, 1e-3, 0.049999, 0.050001])
def test_small_turns_are_accurate_to_rounding(theta):
    _, Q = constant_turn(np.array([1.0, 0.0, theta]), np.array([1e-9, 1e-9, 1.0]), 1.0)

    # The part of x by omega, v d(sin(theta) / theta) / d theta, as a longer series.
    slope = -theta / 3 + theta**3 / 30 - theta**5 / 840 + theta**7 / 45360
    assert Q[0, 2] == pytest.approx(slope, rel=1e-12)


@pytest.mark.parametrize(('index', 'name'), [
    (0, 'sigma_v'), (1, 'sigma_v_lat'), (2, 'sigma_omega')])
@pytest.mark.parametrize('bad', [0.0, -0.1, np.nan])
def test_singular_noise_is_rejected_by_name(index, name, bad):
    sigma = SIGMA.copy()
    sigma[index] = bad

    with pytest.raises(UserError, match=f'^{name} is .*; it must be positive'):
        constant_turn(np.array([0.5, 0.0, 0.1]), sigma, T)


@pytest.mark.parametrize('bad', [0.0, -1.0])
def test_a_duration_that_is_not_positive_is_rejected(bad):
    with pytest.raises(UserError, match=r'^T is .*; it must be positive'):
        constant_turn(np.array([0.5, 0.0, 0.1]), SIGMA, bad)


@pytest.mark.parametrize('omega', [4.0 * np.pi, -20.0])
def test_a_full_turn_within_one_sample_is_rejected(omega):
    with pytest.raises(UserError, match='take a shorter T'):
        constant_turn(np.array([0.5, 0.0, omega]), SIGMA, T)


@pytest.mark.parametrize('beta', [0.0, 0.7, -2.0, 3.1])
@pytest.mark.parametrize('sigma', [(0.01, 0.012), (0.03, 0.15), (0.5, 0.6), (1e-3, 1e-6)])
def test_the_covariance_of_a_polar_observation_is_its_mean_squared_error(beta, sigma):
    def position(r, b):
        return np.array([r * np.cos(b), r * np.sin(b)])

    z, R = polar(3.0, beta, *sigma)

    mean, P = moments(position, (3.0, beta), sigma)
    assert_allclose(z, position(3.0, beta), atol=1e-15)
    assert_allclose(R, P + np.outer(mean - z, mean - z), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(('values', 'name'), [
    ((0.0, 0.1, 0.01, 0.01), 'range r'), ((2.0, 0.1, 0.0, 0.01), 'sigma_r'),
    ((2.0, 0.1, 0.01, 0.0), 'sigma_beta')])
def test_a_polar_observation_without_noise_or_range_is_rejected_by_name(values, name):
    with pytest.raises(UserError, match=f'^{name} is 0; it must be positive'):
        polar(*values)
