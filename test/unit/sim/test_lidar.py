# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The ranges of beams are the distances of discs and walls."""

import numpy as np
import pytest

from fej_slam_ros.sim.lidar import LidarSettings, measured, true_ranges

NO_DISCS, NO_WALLS = np.empty((0, 3)), np.empty((0, 4))


def test_a_beam_meets_a_disc_at_its_near_side():
    pose = np.array([[1.0, 1.0, np.pi / 2]])

    ranges = true_ranges(pose, np.zeros(1), np.array([[1.0, 5.0, 0.5]]), NO_WALLS)

    assert ranges == pytest.approx([3.5], abs=1e-12)


@pytest.mark.parametrize('angle', [-0.9, 0.0, 0.4])
def test_a_beam_meets_a_wall_by_its_cosine(angle):
    ranges = true_ranges(
        np.zeros((1, 3)), np.array([angle]), NO_DISCS, np.array([[2.0, -9.0, 2.0, 9.0]]))

    assert ranges == pytest.approx([2.0 / np.cos(angle)], rel=1e-12)


def test_what_is_behind_or_beside_is_not_met():
    ranges = true_ranges(
        np.zeros((1, 3)), np.zeros(1), np.array([[-3.0, 0.0, 0.5], [3.0, 0.6, 0.5]]),
        np.array([[-2.0, -1.0, -2.0, 1.0], [2.0, 0.1, 2.0, 1.0]]))

    assert ranges == [np.inf]


def test_the_nearer_of_two_objects_is_met():
    ranges = true_ranges(
        np.zeros((1, 3)), np.zeros(1), np.array([[3.0, 0.0, 0.5], [5.0, 0.0, 0.5]]),
        np.array([[4.0, -1.0, 4.0, 1.0]]))

    assert ranges == pytest.approx([2.5], rel=1e-12)


def test_measured_ranges_have_the_noise_dropouts_and_limit_of_the_settings():
    settings = LidarSettings(range_sigma=0.05, dropouts=0.1, range=8.0)
    true = np.repeat([5.0, 9.0], 20_000)

    ranges = measured(true, settings, np.random.default_rng(0))

    near = ranges[:20_000]
    # Both vary by 2 % or less over 20,000 beams.
    assert np.std(near[np.isfinite(near)]) == pytest.approx(0.05, rel=0.02)
    assert np.mean(np.isinf(near)) == pytest.approx(0.1, abs=0.01)
    assert np.isinf(ranges[20_000:]).all()
