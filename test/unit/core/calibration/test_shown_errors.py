# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors count as shown if they exceed what the data, in periods of driving, leave open."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.calibration.shown_errors import ErrorFit, ErrorLimits

LIMITS = ErrorLimits(
    none=np.zeros(1), prior_sigma=np.array([0.1]), max_standard_error=np.array([0.01]),
    min_error=np.array([0.005]))


@pytest.mark.parametrize(('x', 'sigma', 'known', 'shown'), [
    (0.09, 0.0115, True, True),  # of a camera that is turned by 5 degrees
    (0.03, 0.0115, False, False), (0.09, 0.0205, False, False),
    (0.03, 0.009, True, False), (0.039, 0.0095, True, True), (0.004, 0.0005, True, False),
    (0.299, 0.0005, False, False)])
def test_an_error_of_four_standard_errors_need_not_be_known_as_well_as_none(
        x, sigma, known, shown):
    got = LIMITS.judged(np.array([x]), np.array([sigma]))

    assert [flags.item() for flags in got[:2]] == [known, shown]


@pytest.mark.parametrize(('driving', 'factor'), [(20, 20 / 17), (10, 10 / 7), (3, np.inf)])
def test_periods_at_rest_do_not_make_an_error_more_certain(driving, factor):
    pairs, blocks = 200, 20
    block = np.arange(pairs) % blocks
    is_driving = (block < driving)[:, None]
    # Alternating gradients, so that their mean over the blocks is 0.
    gradients = is_driving * np.where(block % 2, 1.0, -1.0)[:, None]
    if driving % 2:
        gradients[block == driving - 1] = 0.0
    fit = ErrorFit(np.zeros(1), 1e4 * np.eye(1), gradients, 1.0 * is_driving, 0.0)

    _, sigma = fit.standard_errors(block)

    # The square of the sum over a block is 100, the information 1e4.
    expected = np.sqrt((driving - driving % 2) * 100.0 * factor) / 1e4
    assert_allclose(np.minimum(sigma, 1.0), np.minimum(expected, 1.0), rtol=1e-12)
    assert_array_equal(sigma > 1.0, factor == np.inf)
