# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arithmetic on the elements of many matrices is that of each matrix."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.geometry import pose_rotation
from fej_slam_ros.core.models import Phi
from fej_slam_ros.core.smoothing.packed_matrices import (
    inverse, packed, quadratic, rotated, transported, unpacked)


@pytest.fixture
def P():
    root = np.random.default_rng(1).normal(size=(4, 3, 3))
    return root @ root.transpose(0, 2, 1)


def test_inverse_and_quadratic_form_are_those_of_each_matrix(P):
    r = np.random.default_rng(2).normal(size=(4, 3))

    assert_allclose(unpacked(inverse(packed(P))), np.linalg.inv(P), rtol=1e-9)
    assert quadratic(packed(P), *r.T) == pytest.approx(
        sum(r_k @ P_k @ r_k for r_k, P_k in zip(r, P)), rel=1e-12)


def test_rotated_and_transported_covariances_are_those_of_each_matrix(P):
    angles, d = np.array([0.3, -2.0, 0.0, 3.1]), np.random.default_rng(3).normal(size=(4, 2))

    turned = rotated(packed(P), np.cos(angles), np.sin(angles))
    moved = transported(packed(P), *d.T)

    for k, (G, T) in enumerate(zip(map(pose_rotation, angles), map(Phi, d))):
        assert_allclose(unpacked(np.stack(turned))[k], G @ P[k] @ G.T, rtol=1e-12, atol=1e-12)
        assert_allclose(unpacked(np.stack(moved))[k], T @ P[k] @ T.T, rtol=1e-12, atol=1e-12)


def test_a_singular_matrix_has_no_inverse(P):
    P[2, :, 1] = P[2, 1] = 0.0

    with pytest.raises(np.linalg.LinAlgError):
        inverse(packed(P))
