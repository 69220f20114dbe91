# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Increments between odometry records, and their division at scans."""

from math import cos, pi, sin

import numpy as np
import pytest

from fej_slam_ros.core.ordering.odometry_increments import increment, split
from helpers.records import odometry

SIGMA = (0.2, 0.1, 0.4)

#: A covariance in which no two entries are alike, and C^T Q C for a quarter turn to the left,
#: which takes (x, y) to (y, -x).
Q = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, 0.25], [0.5, 0.25, 1.0]])
Q_TURNED = np.array([[2.0, -1.0, 0.25], [-1.0, 4.0, -0.5], [0.25, -0.5, 1.0]])

ROUNDING = 1e-14


@pytest.mark.parametrize(('p0', 'p1', 'u'), [
    ((1.0, 2.0, pi / 2), (1.0, 5.0, pi), (3.0, 0.0, pi / 2)),
    ((0.0, 0.0, pi), (2.0, 1.0, pi / 2), (-2.0, -1.0, -pi / 2)),
    ((0.0, 0.0, 3.0), (0.0, 0.0, -3.0), (0.0, 0.0, 2.0 * pi - 6.0)),
    ((5.0, 0.0, -3.0), (6.0, 0.0, 3.0), (cos(3.0), sin(3.0), 6.0 - 2.0 * pi)),
])
def test_an_increment_is_given_in_the_frame_of_its_beginning(p0, p1, u):
    found, _ = increment(odometry('r1', 0, p0), odometry('r1', 100, p1), SIGMA)

    np.testing.assert_allclose(found, u, atol=ROUNDING)


def test_an_increment_has_the_covariance_of_the_later_twist_times_its_duration_squared():
    earlier = odometry('r1', 1000, twist_covariance=np.eye(3))
    later = odometry('r1', 1500, twist_covariance=4.0 * Q)

    _, found = increment(earlier, later, SIGMA)

    np.testing.assert_allclose(found, Q, rtol=ROUNDING)


def test_an_increment_of_unknown_covariance_has_sigma_per_square_root_of_a_second():
    earlier = odometry('r1', 1000, twist_covariance=np.eye(3))

    _, found = increment(earlier, odometry('r1', 1250), SIGMA)

    np.testing.assert_allclose(found, np.diag([0.01, 0.0025, 0.04]), rtol=1e-12, atol=0.0)


def test_the_parts_of_an_increment_share_its_displacement_and_its_covariance():
    first, rest = split(np.array([4.0, 2.0, 2.0 * pi / 3.0]), Q, 0.75)

    np.testing.assert_allclose(first[0], [3.0, 1.5, pi / 2], atol=ROUNDING)
    np.testing.assert_allclose(first[1], 0.75 * Q, atol=ROUNDING)
    np.testing.assert_allclose(rest[0], [0.5, -1.0, pi / 6], atol=ROUNDING)
    np.testing.assert_allclose(rest[1], 0.25 * Q_TURNED, atol=ROUNDING)
