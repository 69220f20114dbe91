# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data of several sensors have stamps of their own, those of one that are sent again the same."""

from fej_slam_ros.ros.session.distinct_stamps import DistinctStamps


def test_sensors_at_one_time_are_a_nanosecond_apart():
    stamps = DistinctStamps()

    assert [stamps.of(5, sensor) for sensor in 'abc'] == [5, 6, 7]
    assert stamps.of(6, 'd') == 8
    assert stamps.of(4, 'd') == 4


def test_data_that_are_sent_twice_have_one_stamp():
    stamps = DistinctStamps()

    assert [stamps.of(5, sensor) for sensor in 'abab'] == [5, 6, 5, 6]
