# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many poses are moved as each of them is, and interpolated."""

import numpy as np
from numpy.testing import assert_array_equal

from fej_slam_ros.core.geometry import compose, poses_at, transform_poses


def test_poses_are_transformed_as_they_are_composed_bit_for_bit():
    rng = np.random.default_rng(1)
    headings = np.append(rng.uniform(-np.pi, np.pi, 100), [np.pi, 0.0, 1e-7 - np.pi])
    poses = np.column_stack([rng.normal(0.0, 100.0, (len(headings), 2)), headings])
    for pose in poses:
        assert_array_equal(transform_poses(pose, poses), [compose(pose, other) for other in poses])


def test_no_poses_stay_no_poses():
    assert transform_poses(np.ones(3), np.empty((0, 3))).shape == (0, 3)


def test_between_two_stamps_a_heading_goes_the_short_way():
    poses = np.array([[0.0, 0.0, 3.0], [2.0, 4.0, -3.0]])

    halfway = poses_at(np.array([5]), np.array([0, 10]), poses)

    np.testing.assert_allclose(halfway, [[1.0, 2.0, np.pi]], atol=1e-15)
