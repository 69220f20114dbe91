# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definiteness of covariances."""

import numpy as np
import pytest

from fej_slam_ros.core.definiteness import (
    are_definite, has_information, is_definite, is_semidefinite)
from fej_slam_ros.core.geometry import pose_rotation


def test_covariances_are_definite_together_as_each_alone():
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(40, 3, 3)) * np.geomspace(1e-9, 1.0, 3)[:, None]
    roots[10:20, 2] = roots[10:20, 1]
    P = roots @ roots.transpose(0, 2, 1)
    P[20:30, 0, 0] = [0.0, -1.0] * 5

    assert are_definite(P).tolist() == [is_definite(block) for block in P]
    assert are_definite(P).tolist() == 10 * [True] + 20 * [False] + 10 * [True]


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('variances', 'covariance', 'expected'), [
    ((1e-308, 1e-308), 1e308, False), ((5e-324, 5e-324), 1e-320, False),
    ((1e-320, 1e308), 1e-10, True), ((1e308, 1e308), 1.7e308, False)])
def test_the_definiteness_of_extreme_covariances_is_known_without_a_warning(
    variances, covariance, expected,
):
    P = np.diag(variances)
    P[0, 1] = P[1, 0] = covariance

    assert is_definite(P) is expected
    assert are_definite(P[None]).tolist() == [expected]


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize(('variances', 'expected'), [
    ((1e-24, 1e-24, 1e-24), True), ((1e12, 1e12, 1e12), True), ((1e-3, 1e12, 1e-24), True),
    ((1e-300, 1e-300, 1e-300), False), ((1.0, 1.0, 1e-25), False), ((1e-12, 1e12, 1.0), False),
    ((1.0, 0.0, 1.0), False)])
def test_a_velocity_has_information_if_its_covariance_is_definite_after_any_turn(
    variances, expected,
):
    assert has_information(np.diag(variances)) is expected

    for yaw in np.linspace(-3.0, 3.0, 25):
        C = pose_rotation(yaw)
        # Of a nanosecond.
        Q = 1e-18 * C @ np.diag(variances) @ C.T
        assert not expected or np.linalg.det(Q[:2, :2]) * Q[2, 2] > 0.0


@pytest.mark.parametrize(('P', 'expected'), [
    ([[1.0, 1.0], [1.0, 1.0]], True), ([[1.0, 1.0], [1.0, 1.0 - 5e-8]], True),
    ([[1.0, 1.00001], [1.00001, 1.0]], False), ([[0.0, 0.0], [0.0, 1.0]], True),
    ([[0.0, 0.1], [0.1, 1.0]], False), ([[-1e-9, 0.0], [0.0, 1.0]], False),
    ([[1e-12, 1.0], [1.0, 1e12]], True)])
def test_a_covariance_may_be_singular_up_to_rounding_in_any_units(P, expected):
    assert is_semidefinite(np.array(P)) is expected
