# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows written late are told from stamps that pass a time twice."""

import numpy as np
import pytest

from fej_slam_ros.core.ordering.backward_stamps import breaks, steps_back

MS = 1_000_000


def regular(begin, end, period=20):
    """Return stamps [ns] from one millisecond to another, each 20 ms with 4 ms of jitter."""
    stamps = np.arange(begin, end, period)
    jitter = np.random.default_rng(1).integers(-4, 5, len(stamps))
    return (stamps + jitter) * MS


def test_a_log_in_order_has_no_step_back():
    assert steps_back(regular(0, 10_000)) == []
    assert breaks(regular(0, 10_000)) == []


def test_disorder_below_a_tenth_of_a_second_is_no_step_back():
    stamps = regular(0, 10_000)
    stamps[[100, 104]] = stamps[[104, 100]]

    assert steps_back(stamps) == []


@pytest.mark.parametrize('stamps', [
    pytest.param([regular(0, 4000), regular(5000, 7000), regular(4000, 5000),
                  regular(7000, 9000)], id='buffer written late'),
    pytest.param([regular(5000, 9000), regular(0, 5000)], id='logs in the wrong order'),
    pytest.param([regular(0, 3000), regular(4000, 5000), regular(3000, 3500),
                  regular(5000, 6000), regular(3500, 4000)], id='two buffers'),
])
def test_rows_that_fill_a_gap_are_late(stamps):
    stamps = np.concatenate(stamps)

    assert len(steps_back(stamps)) >= 1
    assert breaks(stamps) == []


@pytest.mark.parametrize('back', [200, 2000, 7000])
def test_a_clock_that_is_set_back_is_a_break(back):
    stamps = np.concatenate([regular(0, 8000), regular(8000 - back, 20_000)])

    assert breaks(stamps) == [len(regular(0, 8000))]


def test_a_clock_that_is_set_back_to_long_before_is_a_break():
    stamps = np.concatenate([regular(3_600_000, 3_620_000), regular(20_000, 300_000)])

    assert breaks(stamps) == [len(regular(3_600_000, 3_620_000))]


def test_a_short_log_appended_to_a_longer_one_of_the_same_time_is_a_break():
    first = regular(0, 900_000)

    assert breaks(np.concatenate([first, regular(300_000, 400_000)])) == [len(first)]


def test_the_rate_at_the_break_decides_where_it_changes():
    slow, fast = regular(0, 20_000, period=50), regular(20_000, 60_000)

    # Five times 50 ms: twice as many rows as before, but fewer than at the rate of the log.
    stamps = np.concatenate([slow, regular(18_000, 20_000, period=50), fast])

    assert breaks(stamps) == [len(slow)]


@pytest.mark.parametrize('stamps', [[], [5 * MS], [10 * MS, 0]])
def test_logs_of_a_few_rows_are_in_order(stamps):
    assert breaks(np.array(stamps, np.int64)) == []
