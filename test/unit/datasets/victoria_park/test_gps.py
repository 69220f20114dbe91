# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What GPS says is believed where wheels and neighbours bear it out."""

import numpy as np
import pytest

from fej_slam_ros.core.geometry import transform
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.victoria_park.gps import (
    ANTENNA, antenna_points, outliers, start_pose)
from fej_slam_ros.datasets.victoria_park.raw_log import Fixes
from fej_slam_ros.errors import UserError

START = np.array([100.0, 200.0, 2.0])
#: Where wheels have the antenna, 1 m on every 0.2 s.
THERE = ANTENNA + np.column_stack([np.arange(60.0), np.zeros(60)])
STAMPS = np.arange(60) * NS // 5


def fixes(stamps=STAMPS):
    return Fixes(np.array(stamps), transform(START, THERE))


def test_the_antenna_goes_round_with_the_car():
    # Half way, across the jump of the heading from pi to -pi, the car looks to where x falls.
    poses = np.array([[0.0, 0.0, np.pi - 0.1], [2.0, 0.0, 0.1 - np.pi]])

    place = antenna_points(np.array([5]), np.array([0, 10]), poses)

    np.testing.assert_allclose(place, [[1.0, 0.0] - ANTENNA], atol=1e-12)  # rounding of sines


def test_gps_that_moves_as_the_wheels_do_is_believed():
    assert not outliers(fixes(), THERE).any()


@pytest.mark.parametrize(('first', 'count', 'are_doubted'), [(30, 1, True), (30, 4, True),
                                                             (30, 5, False), (0, 2, True)])
def test_few_fixes_between_jumps_are_doubted(first, count, are_doubted):
    jumped = fixes()
    jumped.points[first:first + count] += 137.0

    found = np.flatnonzero(outliers(jumped, THERE))

    assert found.tolist() == are_doubted * list(range(first, first + count))


def test_few_fixes_between_gaps_are_doubted_even_if_they_do_not_jump():
    late = STAMPS + 2 * NS * (np.arange(60) >= 30) + 2 * NS * (np.arange(60) >= 32)

    assert np.flatnonzero(outliers(fixes(late), THERE)).tolist() == [30, 31]


def test_good_fixes_tell_where_the_drive_begins():
    some = np.arange(60) == 7
    jumped = fixes()
    jumped.points[some] += 50.0

    np.testing.assert_allclose(start_pose(jumped, THERE, some), START, atol=1e-9)  # rounding at 200 m


def test_wheels_are_not_trusted_after_they_have_led_far_away():
    back = np.vstack([THERE, THERE[::-1]])
    turned = Fixes(np.arange(120), np.vstack([fixes().points, fixes().points[::-1] + 30.0]))

    place = start_pose(turned, back, np.zeros(120, dtype=bool))

    np.testing.assert_allclose(place, START, atol=1e-9)  # rounding at 200 m


@pytest.mark.parametrize('good', [0, 10, 24])
def test_a_start_that_gps_does_not_tell_is_refused(good):
    with pytest.raises(UserError, match='too few good fixes in the first 50 m'):
        start_pose(fixes(), THERE, np.arange(60) >= good)
