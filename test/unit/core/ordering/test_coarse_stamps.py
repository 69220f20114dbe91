# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps in coarse steps are distinguished from repeated messages and from two publishers."""

import numpy as np
import pytest

from fej_slam_ros.core.ordering.coarse_stamps import coarse_step
from fej_slam_ros.core.records import NS

MS = NS // 1000


def driven(period, seconds=60):
    """Return stamps [ns] at a period [ms], and the positions of a robot on a circle."""
    stamps = np.arange(0, seconds * NS, period * MS)
    angles = 0.1 * stamps / NS
    return stamps, np.column_stack([5.0 * np.sin(angles), -5.0 * np.cos(angles)])


@pytest.mark.parametrize(('period', 'step'), [(100, 1000), (50, 100), (20, 100), (33, 1000)])
@pytest.mark.parametrize('rounded', [np.floor, np.round])
def test_stamps_in_steps_longer_than_the_period_are_coarse(period, step, rounded):
    stamps, positions = driven(period)

    coarse = rounded(stamps / (step * MS)).astype(np.int64) * (step * MS)

    assert coarse_step(coarse, positions) == step * MS


@pytest.mark.parametrize('period', [1000, 100, 10])
def test_one_message_at_each_stamp_is_not_coarse_whatever_the_digits(period):
    assert coarse_step(*driven(period)) is None


def test_a_position_that_is_published_several_times_is_not_coarse():
    stamps, positions = driven(100)

    assert coarse_step(np.repeat(stamps, 3), np.repeat(positions, 3, axis=0)) is None


@pytest.mark.parametrize('apart', [0.001, 0.05, 1.0])
def test_two_publishers_are_not_coarse(apart):
    stamps, positions = driven(100)
    other = positions + np.array([0.0, apart])

    both = np.stack([positions, other], axis=1).reshape(-1, 2)

    assert coarse_step(np.repeat(stamps, 2), both) is None


def test_a_robot_at_rest_is_not_coarse():
    assert coarse_step(np.repeat(np.arange(60) * NS, 10), np.zeros((600, 2))) is None
