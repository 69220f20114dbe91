# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise scale factors from normalised errors."""

import math

import numpy as np
import pytest

from fej_slam_ros.core.calibration.scales_of_errors import noise_scale, noise_scales


def test_the_standard_error_equals_the_spread_of_the_factor():
    found = [
        noise_scale(np.random.default_rng(seed).chisquare(3, 100), 3) for seed in range(400)]

    spread = np.std([np.log(f.scale) for f in found])

    # The standard error of the spread of 400 samples is 1 / sqrt(800) = 3.5 %.
    assert spread == pytest.approx(found[0].relative_error, rel=0.15)


def test_large_errors_of_a_part_of_the_time_count_if_they_are_no_outliers():
    # Of 1 m for three fifths of the time, of 5 m for the rest.
    squared = np.random.default_rng(1).chisquare(2, 2000) * np.repeat([1.0, 25.0], [1200, 800])

    assert noise_scale(squared.tolist(), 2).scale == pytest.approx(math.sqrt(10.6), rel=0.05)


def test_a_robot_without_errors_changes_no_factor():
    squared = np.random.default_rng(1).chisquare(3, 400).tolist()

    assert noise_scales({'r1': squared, 'r2': []}, 3) == dict.fromkeys(
        ['', 'r1'], noise_scale(squared, 3))


@pytest.mark.parametrize('rounding', [0.0, 1e-28, 1e-14])
def test_errors_of_0_or_of_rounding_determine_no_factor(rounding):
    squared = (rounding * np.random.default_rng(1).chisquare(3, 40)).tolist()

    found = noise_scales({'r1': squared, 'r2': squared}, 3)

    assert not found[''].is_known()


def test_one_robot_that_differs_has_its_own_factor_also_with_little_data():
    rng = np.random.default_rng(1)
    errors = {
        f'r{k}': (factor ** 2 * rng.chisquare(2, 60)).tolist()
        for k, factor in enumerate((1.0, 1.0, 4.0, 1.0))}

    found = noise_scales(errors, 2)

    # The team's factor is that of the others.
    assert found.keys() == {'', 'r2'}
    assert [found[robot].scale for robot in ('', 'r2')] == pytest.approx([1.0, 4.0], rel=0.2)
    assert found[''].samples == 180
