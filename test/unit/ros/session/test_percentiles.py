# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Percentiles of measured times, with linear interpolation between neighbours."""

import numpy as np
import pytest

from fej_slam_ros.ros.session.percentiles import Percentiles, percentiles


def test_percentiles_are_interpolated_and_independent_of_the_order():
    times = np.random.default_rng(1).permutation(np.arange(201.0))

    result = percentiles(times)

    assert (result.median, result.p99, result.longest) == pytest.approx((100.0, 198.0, 200.0))
    assert percentiles(np.array([1.0, 2.0])).median == 1.5


def test_a_single_time_is_each_percentile():
    assert percentiles(np.array([0.25])) == Percentiles(0.25, 0.25, 0.25)


def test_percentiles_of_no_times_are_zero():
    assert percentiles(np.array([])) == Percentiles(0.0, 0.0, 0.0)
