# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Wrong observations are left out of a smoothed map, and right ones never."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.outlier_removal import without_outliers
from fej_slam_ros.core.smoothing.least_squares import solve
from helpers.csam import Met


def local_map(seed, wrong=(), by=(0.0, 5.0)):
    """Return a map of six landmarks seen from each of 31 poses; some observations are off."""
    local, _ = Met(seed, [], steps=30).maps
    z = local.problem.landmarks.z.copy()
    z[list(wrong)] += by
    observations = replace(local.problem.landmarks, z=z)
    return replace(local, problem=replace(local.problem, landmarks=observations))


@pytest.mark.parametrize('seed', range(5))
def test_where_all_are_right_all_are_taken(seed):
    alone = local_map(seed)

    found, outliers = without_outliers(alone, 0.999)

    assert outliers == []
    expected = solve(alone.problem, alone.values).values
    assert_allclose(found.values.poses, expected.poses, rtol=0.0, atol=0.0)


@pytest.mark.parametrize('wrong', [[40], [0, 100], [*range(3, 186, 20)]])
def test_the_map_is_that_of_the_right_ones(wrong):
    alone = local_map(6, wrong)
    seen = alone.problem.landmarks

    found, outliers = without_outliers(alone, 0.999)

    assert sorted((o.pose, o.landmark) for o in outliers) == sorted(
        (int(seen.pose[m]), alone.landmarks[seen.landmark[m]]) for m in wrong)
    right = np.delete(np.arange(len(seen.z)), wrong)
    without = replace(
        seen, pose=seen.pose[right], landmark=seen.landmark[right], z=seen.z[right],
        R=seen.R[right])
    expected = solve(replace(alone.problem, landmarks=without), alone.values).values
    assert_allclose(found.values.poses, expected.poses, atol=1e-8)
    assert_allclose(found.values.points, expected.points, atol=1e-8)
    for outlier in outliers:
        assert outlier.d2 > outlier.limit


def test_a_probability_of_one_takes_all():
    _, outliers = without_outliers(local_map(7, [40]), 1.0)

    assert outliers == []


def test_where_the_noise_is_not_what_it_is_said_to_be_all_are_taken():
    alone = local_map(8)
    seen = alone.problem.landmarks
    noisy = seen.z + np.random.default_rng(1).normal(0.0, 3.0, seen.z.shape)
    told = replace(alone, problem=replace(alone.problem, landmarks=replace(seen, z=noisy)))

    found, outliers = without_outliers(told, 0.999)

    assert outliers == []
    assert len(found.problem.landmarks.z) == len(seen.z)
