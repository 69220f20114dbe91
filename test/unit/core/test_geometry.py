# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms of poses and points, inverse, interpolation and fit."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.geometry import (
    compose, inverse, pose_at, pose_difference, poses_at, products, rigid_fit, rotations, runs,
    starts_of, symmetric, transform, transform_poses, upper_triangular)
from helpers.core import turn
from helpers.records import MS, odometry


def test_transform_poses_equals_compose_bit_for_bit():
    rng = np.random.default_rng(1)
    headings = np.append(rng.uniform(-np.pi, np.pi, 100), [np.pi, 0.0, 1e-7 - np.pi])
    poses = np.column_stack([rng.normal(0.0, 100.0, (len(headings), 2)), headings])
    for pose in poses:
        assert_array_equal(transform_poses(pose, poses), [compose(pose, other) for other in poses])


def test_transform_poses_of_no_poses_is_empty():
    assert transform_poses(np.ones(3), np.empty((0, 3))).shape == (0, 3)


def test_the_difference_of_poses_has_a_wrapped_heading():
    a, b = np.array([1.0, 2.0, np.pi - 0.1]), np.array([0.0, 0.0, 0.2 - np.pi])

    assert_allclose(pose_difference(a, b), [1.0, 2.0, -0.3], atol=1e-15)


def test_headings_are_interpolated_across_pi():
    poses = np.array([[0.0, 0.0, 3.0], [2.0, 4.0, -3.0]])

    halfway = poses_at(np.array([5]), np.array([0, 10]), poses)

    assert_allclose(halfway, [[1.0, 2.0, np.pi]], atol=1e-15)


def test_poses_between_stamps_since_1970_are_interpolated_to_the_nanosecond():
    epoch = 1_700_000_000_000_000_000
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])

    # Floats of this size are 256 apart.
    (found,) = poses_at(np.array([epoch + 3]), epoch + np.array([0, 10]), poses)

    assert_allclose(found, [0.3, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize(('ms', 'x'), [
    (-1, None), (0, 0.0), (50, 0.05), (100, 0.1), (200, None), (600, 0.6), (601, None)])
def test_a_pose_is_interpolated_within_and_not_across_a_long_gap(ms, x):
    known = [odometry('r1', at) for at in (0, 100, 600)]

    found = pose_at(ms * MS, known, 400 * MS)

    assert (found is None) == (x is None)
    if x is not None:
        assert_allclose(found, [x, 0.0, 0.0], atol=1e-15)


def test_inverse_undoes_a_pose_and_a_transform():
    T_a_b, points_b = np.array([3.0, -2.0, 2.5]), np.array([[1.0, 2.0], [-4.0, 0.5]])

    T_b_a = inverse(T_a_b)

    assert_allclose(compose(T_a_b, T_b_a), np.zeros(3), atol=1e-15)
    assert_allclose(compose(T_b_a, T_a_b), np.zeros(3), atol=1e-15)
    assert_allclose(transform(T_b_a, transform(T_a_b, points_b)), points_b, atol=1e-14)


def test_an_upper_triangle_of_any_size_is_a_triangular_or_symmetric_matrix():
    assert upper_triangular([7.0]).tolist() == [[7.0]]
    assert upper_triangular([1.0, 2.0, 3.0]).tolist() == [[1.0, 2.0], [0.0, 3.0]]
    assert symmetric([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).tolist() == [
        [1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]]
    for size in range(1, 40):
        assert upper_triangular(np.ones(size * (size + 1) // 2)).shape == (size, size)


def test_a_rigid_fit_gives_back_the_motion():
    rng, pose = np.random.default_rng(7), np.array([3.0, -4.0, 2.9])
    source = rng.uniform(-5.0, 5.0, (4, 2))

    assert_allclose(rigid_fit(source, source @ turn(2.9).T + pose[:2]), pose, atol=1e-14)


def test_a_rigid_fit_brings_the_most_certain_points_nearest():
    of_q = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 5.0]])
    b = np.array([3.0, -1.0, 2.0])
    of_p = of_q @ turn(2.0).T + b[:2] + np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 0.3]])

    found = rigid_fit(of_q, of_p, np.array([1.0, 1.0, 1e-9]))

    assert_allclose(found, b, atol=1e-8)


def test_many_rotations_turn_each_vector_by_its_angle():
    rng = np.random.default_rng(2)
    angles, vectors = rng.uniform(-np.pi, np.pi, 5), rng.normal(size=(5, 2))

    turned = products(rotations(angles), vectors)

    assert_allclose(turned, [turn(angle) @ v for angle, v in zip(angles, vectors)], atol=1e-15)


def test_runs_one_after_another_are_all_indices():
    lengths = np.array([2, 0, 3, 1])

    assert_array_equal(starts_of(lengths), [0, 2, 2, 5])
    assert_array_equal(runs(starts_of(lengths), lengths), np.arange(6))
    assert_array_equal(runs(np.array([7, 0, 3, 0]), lengths), [7, 8, 3, 4, 5, 0])
