# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reflectors are found by their intensity, whatever their shape."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.detection.detections import RejectedSegment
from fej_slam_ros.detection.reflectors import ReflectorDetector
from helpers.lasers import scan_of

POST = np.array([3.0, 1.0, 0.15])


def bright(scan, nearer_than):
    return replace(scan, intensities=np.where(scan.ranges < nearer_than, 900.0, 100.0))


def test_errors_of_round_reflectors_are_as_large_as_the_covariance_says():
    rng, values = np.random.default_rng(0), []
    for seed in range(400):
        angle, distance = rng.uniform((-3.1, 1.0), (3.1, 6.0))
        post = np.array([distance * np.cos(angle), distance * np.sin(angle), 0.15])
        scan = bright(scan_of(post, [9.0, -9.0, 9.0, 9.0], sigma=0.02, seed=seed), 7.0)
        found = ReflectorDetector(500.0, radius=0.15, range_sigma=0.02)(scan)
        for point, R in zip(found.points, found.R):
            error = point - post[:2]
            values.append(error @ np.linalg.solve(R, error) / 2.0)
    assert len(values) == 400
    # The mean of 400 values of chi-square(2)/2 varies by 0.05; edges are uniform, not normal.
    assert 0.8 < np.mean(values) < 1.2


def test_what_is_not_bright_is_no_reflector():
    scan = bright(scan_of([POST, [-4.0, 0.0, 0.2]], sigma=0.01), 3.5)

    found = ReflectorDetector(500.0, radius=0.15)(scan)

    np.testing.assert_allclose(found.points, POST[None, :2], atol=0.05)


def test_a_reflector_at_the_seam_of_a_full_turn_is_one():
    scan = bright(scan_of([-3.0, 0.0, 0.2], sigma=0.01), 4.0)

    assert ReflectorDetector(500.0, radius=0.2)(scan).points == pytest.approx(
        np.array([[-3.0, 0.0]]), abs=0.05)


def test_a_scan_without_intensities_cannot_be_used():
    with pytest.raises(ValueError, match='without intensities'):
        ReflectorDetector(500.0)(scan_of(POST))


def test_two_reflectors_beside_each_other_at_different_ranges_are_not_one():
    far = [8.0 * np.cos(0.1), 8.0 * np.sin(0.1), 0.5]
    scan = bright(scan_of([[2.0, 0.0, 0.1], far], sigma=0.01), 9.0)

    points = ReflectorDetector(500.0, radius=0.1)(scan).points

    # The far one is hidden in part.
    np.testing.assert_allclose(points, [[2.0, 0.0]], atol=0.05)


def test_a_reflector_that_is_hidden_in_part_is_rejected():
    scan = scan_of([[4.0, 0.0, 0.3], [1.0, 0.1, 0.1]], sigma=0.01)
    scan = replace(scan, intensities=np.where(scan.ranges > 2.0, 900.0, 100.0))

    found = ReflectorDetector(500.0, radius=0.3)(scan)

    assert (len(found.points), found.rejected[RejectedSegment.OCCLUDED]) == (0, 1)
