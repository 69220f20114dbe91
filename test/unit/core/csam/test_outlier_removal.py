# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Outliers are removed from a smoothed map, and correct observations never."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.outlier_removal import without_outliers
from fej_slam_ros.core.smoothing.least_squares import solve
from helpers.csam import Met


def local_map(seed, wrong=(), by=(0.0, 5.0)):
    """Return a map of six landmarks observed from each of 31 poses, with outliers."""
    local, _ = Met(seed, [], steps=30).maps
    z = local.problem.landmarks.z.copy()
    z[list(wrong)] += by
    observations = replace(local.problem.landmarks, z=z)
    return replace(local, problem=replace(local.problem, landmarks=observations))


@pytest.mark.parametrize('seed', range(5))
def test_correct_observations_are_all_kept(seed):
    local = local_map(seed)

    kept, outliers = without_outliers(local, 0.999)

    assert outliers == []
    expected = solve(local.problem, local.values).values
    assert_allclose(kept.values.poses, expected.poses, rtol=0.0, atol=0.0)


@pytest.mark.parametrize('wrong', [[40], [0, 100], [*range(3, 186, 20)]])
def test_the_map_equals_that_of_the_correct_observations(wrong):
    local = local_map(6, wrong)
    factors = local.problem.landmarks

    kept, outliers = without_outliers(local, 0.999)

    assert sorted((o.pose, o.landmark) for o in outliers) == sorted(
        (int(factors.pose[m]), local.landmarks[factors.target[m]]) for m in wrong)
    correct = np.delete(np.arange(len(factors.z)), wrong)
    without = replace(
        factors, pose=factors.pose[correct], target=factors.target[correct],
        z=factors.z[correct], R=factors.R[correct])
    expected = solve(replace(local.problem, landmarks=without), local.values).values
    assert_allclose(kept.values.poses, expected.poses, atol=1e-8)
    assert_allclose(kept.values.points, expected.points, atol=1e-8)
    for outlier in outliers:
        assert outlier.d2 > outlier.limit


def test_probability_one_keeps_all_observations():
    _, outliers = without_outliers(local_map(7, [40]), 1.0)

    assert outliers == []


def test_understated_noise_keeps_all_observations():
    local = local_map(8)
    factors = local.problem.landmarks
    noisy = factors.z + np.random.default_rng(1).normal(0.0, 3.0, factors.z.shape)
    problem = replace(local.problem, landmarks=replace(factors, z=noisy))
    understated = replace(local, problem=problem)

    kept, outliers = without_outliers(understated, 0.999)

    assert outliers == []
    assert len(kept.problem.landmarks.z) == len(factors.z)
