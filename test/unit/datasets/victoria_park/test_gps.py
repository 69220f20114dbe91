# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""GPS outliers are found by dead reckoning and neighbouring fixes."""

import numpy as np
import pytest

from fej_slam_ros.core.geometry import transform
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.series import Series
from fej_slam_ros.datasets.victoria_park.gps import ANTENNA, antenna_points, outliers, start_pose
from fej_slam_ros.errors import UserError

START = np.array([100.0, 200.0, 2.0])
#: Where wheels have the antenna, 1 m on every 0.2 s.
THERE = ANTENNA + np.column_stack([np.arange(60.0), np.zeros(60)])
STAMPS = np.arange(60) * NS // 5


def fixes(stamps=STAMPS):
    return Series(np.array(stamps), transform(START, THERE))


def test_the_antenna_turns_with_the_car():
    # Half way, across the jump of the heading from pi to -pi, the car looks to where x falls.
    poses = np.array([[0.0, 0.0, np.pi - 0.1], [2.0, 0.0, 0.1 - np.pi]])

    place = antenna_points(np.array([5]), np.array([0, 10]), poses)

    np.testing.assert_allclose(place, [[1.0, 0.0] - ANTENNA], atol=1e-12)  # rounding of sines


def test_gps_consistent_with_dead_reckoning_has_no_outliers():
    assert not outliers(fixes(), THERE).any()


@pytest.mark.parametrize(('first', 'count', 'are_doubted'), [(30, 1, True), (30, 4, True),
                                                             (30, 5, False), (0, 2, True)])
def test_few_fixes_between_jumps_are_outliers(first, count, are_doubted):
    jumped = fixes()
    jumped.rows[first:first + count] += 137.0

    found = np.flatnonzero(outliers(jumped, THERE))

    assert found.tolist() == are_doubted * list(range(first, first + count))


def test_few_fixes_between_gaps_are_outliers_even_without_jumps():
    late = STAMPS + 2 * NS * (np.arange(60) >= 30) + 2 * NS * (np.arange(60) >= 32)

    assert np.flatnonzero(outliers(fixes(late), THERE)).tolist() == [30, 31]


def test_good_fixes_determine_the_start_pose():
    some = np.arange(60) == 7
    jumped = fixes()
    jumped.rows[some] += 50.0

    # Rounding at 200 m.
    np.testing.assert_allclose(start_pose(jumped, THERE, some), START, atol=1e-9)


def test_fixes_after_the_car_was_far_from_the_start_are_ignored():
    back = np.vstack([THERE, THERE[::-1]])
    turned = Series(np.arange(120), np.vstack([fixes().rows, fixes().rows[::-1] + 30.0]))

    place = start_pose(turned, back, np.zeros(120, dtype=bool))

    np.testing.assert_allclose(place, START, atol=1e-9)  # rounding at 200 m


@pytest.mark.parametrize('good', [0, 10, 24])
def test_too_few_fixes_for_a_start_pose_are_rejected(good):
    with pytest.raises(UserError, match='too few good fixes in the first 50 m'):
        start_pose(fixes(), THERE, np.arange(60) >= good)
