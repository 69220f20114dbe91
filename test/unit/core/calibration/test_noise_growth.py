# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The growth of noise with the range is found from normalised errors."""

import numpy as np
import pytest

from fej_slam_ros.core.calibration.noise_growth import ErrorAtRange, MIN_ERRORS, noise_growth

RANGES = (0.5, 10.0)


def errors(seed, growth, count=3000, scale=1.7):
    """Return errors whose standard deviation is s (1 + g rho) times the stated one."""
    rng = np.random.default_rng(seed)
    ranges = rng.uniform(*RANGES, count)
    e = rng.normal(size=(count, 2)) * (scale * (1.0 + growth * ranges))[:, None]
    return [ErrorAtRange(*both) for both in zip(ranges.tolist(), (e ** 2).sum(axis=1).tolist())]


@pytest.mark.parametrize('growth', [0.1, 0.5, 2.0])
@pytest.mark.parametrize('seed', range(3))
def test_the_growth_is_that_of_the_noise_whatever_the_scale_of_each_kind(seed, growth):
    found = noise_growth([
        errors(seed, growth), errors(seed + 10, growth, count=300, scale=0.4)])

    # The ratio of standard deviations at 10 m and at 1 m, from 3,000 errors; 4 standard errors.
    assert (1.0 + 10.0 * found) / (1.0 + found) == pytest.approx(
        (1.0 + 10.0 * growth) / (1.0 + growth), rel=0.25)


def test_the_growth_that_the_stated_noise_has_is_part_of_what_is_found():
    stated = [
        error._replace(d2=error.d2 / (1.0 + 0.3 * error.range) ** 2) for error in errors(1, 0.5)]

    assert noise_growth([stated], stated=0.3) == pytest.approx(
        noise_growth([errors(1, 0.5)]), rel=1e-3)


@pytest.mark.parametrize('seed', range(20))
def test_constant_noise_does_not_grow(seed):
    assert noise_growth([errors(seed, 0.0)]) == 0.0


@pytest.mark.parametrize('scale', [0.0, 1e-12])
def test_observations_without_noise_show_no_growth(scale):
    assert noise_growth([errors(1, 0.5, scale=scale)]) is None


def test_few_errors_show_no_growth():
    assert noise_growth([errors(1, 2.0, MIN_ERRORS - 1)]) is None
    assert noise_growth([errors(1, 2.0, MIN_ERRORS)]) is not None
