# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows written late are distinguished from stamps that pass a time twice."""

import numpy as np
import pytest

from fej_slam_ros.core.ordering.backward_stamps import breaks, recorded_order, steps_back

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


@pytest.mark.parametrize('when', [60, 100, 200])
def test_rows_written_late_while_the_rate_is_high_are_no_break(when):
    # Ten seconds at 50 Hz among a hundred at 8 Hz.
    stamps = np.concatenate([
        regular(0, 50_000, period=120), regular(50_000, 60_000), regular(60_000, 110_000, 120)])
    fast = len(regular(0, 50_000, period=120)) + when
    stamps[fast:fast + 20] = np.roll(stamps[fast:fast + 20], 10)

    assert len(steps_back(stamps)) == 1
    assert breaks(stamps) == []


@pytest.mark.parametrize(('period', 'back'), [
    (120, 500), (120, 300), (100, 250), (100, 200), (200, 700), (200, 500), (200, 400), (50, 200)])
@pytest.mark.parametrize('when', [1, 7, 30])
def test_a_clock_that_is_set_back_by_two_rows_or_more_is_a_break(period, back, when):
    # From 400 ms at 5 Hz on, two rows; also where the stamps after repeat those before exactly.
    stamps = np.arange(0, 60_000, period) * MS
    row = np.searchsorted(stamps, when * 1000 * MS)
    stamps[row:] -= back * MS

    assert breaks(stamps) == [row]


@pytest.mark.parametrize('gap', [10_000, 400])
def test_a_clock_that_is_set_back_next_to_a_gap_is_a_break(gap):
    before = np.concatenate([regular(0, 20_000, 100), regular(20_000 + gap, 20_350 + gap, 100)])
    after = regular(20_350 + gap - 300, 90_000, 100)

    assert breaks(np.concatenate([before, after])) == [len(before)]


@pytest.mark.parametrize('late', [1, 2, 5])
@pytest.mark.parametrize('period', [50, 100, 200, 500])
def test_a_few_rows_written_late_are_no_break(period, late):
    stamps = regular(0, 100_000, period)
    # The rows before are written first; there are as many, and a tenth of a second at least.
    stamps[40:40 + 2 * late + 2] = np.roll(stamps[40:40 + 2 * late + 2], late)

    assert len(steps_back(stamps)) == 1
    assert breaks(stamps) == []


@pytest.mark.parametrize('late', [5, 60])
def test_rows_written_late_across_pauses_are_no_break(late):
    # 67 Hz with pauses of a second, as in MRCLAM.
    stamps = np.concatenate([
        regular(begin, begin + 4000, period=15) for begin in range(0, 100_000, 5000)])
    rng = np.random.default_rng(late)
    places = np.arange(len(stamps), dtype=float)
    is_late = rng.random(len(stamps)) < 0.02
    places[is_late] += late + 0.5

    assert len(steps_back(stamps[places.argsort()])) > 1
    assert breaks(stamps[places.argsort()]) == []


def test_a_row_written_late_where_a_row_is_missing_is_no_break():
    stamps = np.delete(regular(0, 20_000, period=50), [201, 203])
    stamps[[200, 201]] = stamps[[201, 200]]

    assert breaks(stamps) == []


@pytest.mark.parametrize('back', [200, 2000, 7000])
def test_a_clock_that_is_set_back_is_a_break(back):
    stamps = np.concatenate([regular(0, 8000), regular(8000 - back, 20_000)])

    assert breaks(stamps) == [len(regular(0, 8000))]


def written_late(stamps, number, rng, around=()):
    """Return rows of which pairs of blocks of 10 to 25 rows are written in the wrong order."""
    order = np.arange(len(stamps))
    for begin in (*around, *(50 * rng.choice(len(stamps) // 50 - 1, number, replace=False))):
        middle, end = begin + rng.integers(10, 25, 2).cumsum()
        order[begin:end] = np.roll(order[begin:end], begin - middle)
    return order


@pytest.mark.parametrize('seed', range(10))
@pytest.mark.parametrize('back', [2000, 40_000])
def test_a_clock_that_is_set_back_is_found_among_rows_written_late(back, seed):
    rng = np.random.default_rng(seed)
    stamps = np.concatenate([regular(0, 80_000), regular(80_000 - back, 160_000)])
    step, order = len(regular(0, 80_000)), written_late(stamps, 30, rng)

    (row,) = breaks(stamps[order])

    # Blocks of up to 50 rows may have the step inside.
    assert abs(row - step) <= 50


def test_rows_written_late_alone_are_no_break():
    rng = np.random.default_rng(3)
    stamps = regular(0, 160_000)

    assert breaks(stamps[written_late(stamps, 30, rng)]) == []


@pytest.mark.parametrize('before', [3, 12, 20, 30])
def test_blocks_in_the_wrong_order_across_a_step_of_the_clock_are_put_in_order(before):
    rng = np.random.default_rng(before)
    stamps = np.concatenate([regular(0, 80_000), regular(78_000, 160_000)])
    step = len(regular(0, 80_000))
    order = written_late(stamps, 0, rng, around=[step - before])

    recorded = order[recorded_order(stamps[order])]

    np.testing.assert_array_equal(recorded, np.arange(len(stamps)))
    assert breaks(stamps[recorded]) == [step]


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


def in_bursts(seed):
    """Return a log of 60 s whose rows come in bursts of 10 ms, 17.5 ms apart in the mean."""
    steps = np.random.default_rng(seed).choice([10, 10, 10, 40], round(60_000 / 17.5))
    return np.cumsum(steps) * MS


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('back', [500, 3000, 20_000])
def test_a_clock_that_is_set_back_is_a_break_of_a_log_in_bursts(back, seed):
    stamps = in_bursts(seed)
    row = len(stamps) // 2
    stamps[row:] -= back * MS

    assert breaks(stamps) == [row]


def test_another_log_in_bursts_at_the_same_time_is_a_break():
    first, other = in_bursts(1), in_bursts(2)[500:2000] + MS

    assert breaks(np.concatenate([first, other])) == [len(first)]


def test_a_log_in_reverse_may_have_pauses():
    stamps = in_bursts(1)
    stamps[1000:] += 300 * MS
    stamps[2000:] += 5000 * MS

    assert breaks(stamps[::-1]) == []


@pytest.mark.parametrize('stamps', [[], [5 * MS], [10 * MS, 0]])
def test_logs_of_a_few_rows_are_in_order(stamps):
    assert breaks(np.array(stamps, np.int64)) == []


@pytest.mark.parametrize('period', [15, 100, 1000])
def test_a_log_in_reverse_is_of_one_clock(period):
    assert breaks(regular(0, 100_000, period)[::-1]) == []


@pytest.mark.parametrize('seed', range(5))
def test_a_log_in_no_order_is_of_one_clock(seed):
    assert breaks(np.random.default_rng(seed).permutation(regular(0, 40_000))) == []


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize(('share', 'furthest'), [(0.02, 75), (0.05, 500), (0.3, 5)])
@pytest.mark.parametrize('period', [15, 100])
def test_single_rows_written_late_all_over_a_log_are_no_break(period, share, furthest, seed):
    rng = np.random.default_rng(seed)
    stamps = regular(0, 2000 * period, period)
    places = np.arange(len(stamps), dtype=float)
    is_late = rng.random(len(stamps)) < share
    places[is_late] += 0.5 + rng.integers(1, furthest, np.count_nonzero(is_late))

    assert breaks(stamps[places.argsort()]) == []
    # Nor do they hide a clock that is set back: it is found next to late rows.
    stamps[1000:] -= 5000 * MS
    assert any(abs(row - 1000) <= 50 for row in breaks(stamps[places.argsort()]))


@pytest.mark.parametrize(('cycles', 'further'), [(2, 2500), (3, 2500), (4, 0)])
def test_a_clock_that_is_set_back_is_a_break_of_a_log_with_regular_pauses(cycles, further):
    # Rows for 5 s of each 15 s: both sides of the break have far fewer than without pauses.
    stamps = np.concatenate([
        regular(begin, begin + 5000, period=100) for begin in range(0, 300_000, 15_000)])
    row = len(stamps) // 2
    stamps[row:] -= (15_000 * cycles + further) * MS

    assert breaks(stamps) == [row]


@pytest.mark.parametrize(('first', 'late'), [(101, 10), (50, 40)])
def test_rows_written_late_are_no_break_of_a_log_that_is_often_faster(first, late):
    # 20 Hz for 2 s of each 10 s, else 5 Hz.
    stamps = np.concatenate([
        regular(begin + start, begin + end, period) for begin in range(0, 60_000, 10_000)
        for start, end, period in ((0, 2000, 50), (2000, 10_000, 200))])
    stamps[first:first + 2 * late] = np.roll(stamps[first:first + 2 * late], late)

    assert len(steps_back(stamps)) >= 1
    assert breaks(stamps) == []


@pytest.mark.parametrize(('period', 'lost'), [(50, 0.2), (200, 0.4)])
def test_a_clock_that_is_set_back_is_a_break_of_a_log_that_lost_rows(period, lost):
    before, after = regular(0, 20_000, period), regular(19_500, 40_000, period)
    is_kept = np.random.default_rng(0).random(len(before) + len(after)) > lost

    stamps = np.concatenate([before, after])[is_kept]

    assert breaks(stamps) == [np.count_nonzero(is_kept[:len(before)])]


def test_a_log_of_one_row_before_one_of_an_earlier_time_is_a_break():
    assert breaks(np.array([3_600_000, 20_000, 20_100]) * MS) == [1]


def test_pauses_below_a_tenth_of_a_second_do_not_keep_blocks_in_the_wrong_order():
    # Bursts of ten rows in 50 ms, with pauses of 60 ms.
    stamps = np.concatenate([np.arange(begin, begin + 50, 5) for begin in range(0, 11_000, 105)])
    order = np.arange(len(stamps))
    order[400:460] = np.roll(order[400:460], 30)

    recorded = order[recorded_order(stamps[order] * MS)]

    np.testing.assert_array_equal(recorded, np.arange(len(stamps)))
