# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots whose noise differs from that of the others are found one after another."""

from math import exp

import numpy as np
import pytest

from fej_slam_ros.core.calibration.robot_scales import different_robots, NoiseScale


def mean_of(own):
    """Return a function to the mean factor of all robots but some, weighted by their errors."""
    def without(excluded):
        rest = [scale for robot, scale in own.items() if robot not in excluded]
        weights = [scale.relative_error ** -2 for scale in rest]
        return NoiseScale(
            exp(np.average(np.log([scale.scale for scale in rest]), weights=weights)),
            sum(weights) ** -0.5, 100)
    return without


@pytest.mark.parametrize(('factors', 'expected'), [
    ([1.0, 1.1, 0.9, 1.0], []), ([1.0, 3.0, 0.9, 1.0], ['r2']),
    ([1.0, 9.0, 0.3, 1.0, 1.1], ['r2', 'r3']), ([2.0], [])])
def test_all_that_differ_are_found(factors, expected):
    own = {f'r{k}': NoiseScale(factor, 0.05, 100) for k, factor in enumerate(factors, start=1)}

    assert different_robots(own, mean_of(own)) == expected


def test_a_factor_that_is_not_known_differs_from_none():
    own = {'r1': NoiseScale(1.0, 0.05, 100), 'r2': NoiseScale(9.0, 0.2, 3)}

    assert different_robots(own, mean_of(own)) == []
