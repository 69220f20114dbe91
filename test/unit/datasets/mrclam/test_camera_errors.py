# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The noise of a camera is that with which its errors were drawn."""

from dataclasses import astuple

import numpy as np
import pytest

from fej_slam_ros.datasets.mrclam.camera_errors import camera_noise
from fej_slam_ros.datasets.mrclam.observation_errors import ObservationErrors

COUNT = 3000


def errors(constant, per_metre, seed, persistence=1):
    """Return errors at 0.5 to 8 m, each as the one before it for a number of observations."""
    rng = np.random.default_rng(seed)
    r = rng.uniform(0.5, 8.0, COUNT)
    white = np.repeat(rng.standard_normal((2, COUNT // persistence)), persistence, axis=1)
    none = np.zeros(COUNT)
    return ObservationErrors(
        none, none, none, r, np.hypot(constant, per_metre * r) * white[0], 0.01 * white[1])


@pytest.mark.parametrize(('constant', 'per_metre'), [(0.1, 0.03), (0.2, 0.0), (0.05, 0.04)])
def test_constant_and_proportional_noise_of_ranges_are_told_apart(constant, per_metre):
    found = np.mean([
        astuple(camera_noise(errors(constant, per_metre, seed))) for seed in range(10)], axis=0)

    # Variances of 3,000 errors are known to 2.6 %, parts of them less; 0.01 per metre adds 6 % to
    # the variance by 0.2 m on average.
    assert found[0] == pytest.approx(per_metre, rel=0.05, abs=0.01)
    assert found[1] == pytest.approx(0.01, rel=0.01)
    assert found[2] == pytest.approx(constant, rel=0.05)


# Seeds with which the most likely constant part of such errors is above zero.
@pytest.mark.parametrize('seed', [7, 13, 19])
def test_persistent_errors_in_proportion_to_ranges_have_no_constant_part(seed):
    # The limit of outliers is at 4.7 standard deviations or more.
    proportional = errors(0.0, 0.02, seed, persistence=10)

    found = camera_noise(proportional)

    assert found.range_constant == 0.0
    relative = proportional.ranges / proportional.true_ranges
    assert found.range == pytest.approx(np.sqrt(np.mean(relative ** 2)), rel=1e-12)
