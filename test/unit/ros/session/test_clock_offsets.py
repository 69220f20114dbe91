# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clock offsets are reported whatever the delays of single messages."""

import numpy as np

from fej_slam_ros.ros.session.clock_offsets import ClockOffsets, MAX_DELAYS


def clocks_of(**delays):
    clocks = ClockOffsets()
    for robot, of_robot in delays.items():
        for delay in of_robot:
            clocks.add(robot, delay)
    return clocks


def test_the_offset_of_a_clock_is_found_behind_random_delays():
    rng = np.random.default_rng(1)
    # At least 2 ms on the way, at most 50; the clock of b is 3 s ahead of the others.
    on_the_way = rng.integers(2_000_000, 50_000_000, (3, 100))
    a, b, c = on_the_way - np.array([[0], [3_000_000_000], [0]])

    clocks = clocks_of(a=a.tolist(), b=b.tolist(), c=c.tolist())

    # The smallest of 100 delays is seldom more than 5 ms above the least.
    assert abs(clocks.offset('b') - 3_000_000_000) < 5_000_000
    # Of a, one of two others differs, and the median is between them.
    assert abs(clocks.offset('a') + 1_500_000_000) < 5_000_000


def test_only_the_latest_delays_count():
    clocks = clocks_of(a=[-5, *[7] * (MAX_DELAYS - 1)])

    before = clocks.delay('a')
    clocks.add('a', 9)

    assert (before, clocks.delay('a')) == (-5, 7)


def test_a_robot_alone_has_no_offset():
    clocks = clocks_of(a=[3], b=[])

    assert (clocks.offset('a'), clocks.offset('b')) == (None, None)
    assert clocks.delay('b') is None
