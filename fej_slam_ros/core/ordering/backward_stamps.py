# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Stamps of a regular log that step back: rows written late, or another clock.

Rows that are written late, or logs joined in the wrong order, step back to a time of which the log
holds no other rows: sorted by stamp, the log is regular. After a clock was set back, or where two
recordings are joined, the stamps pass a time twice, or return to a time far before all others. In
a time that is passed twice, sorted rows of before and after alternate, and are more than the rate
of the log allows.
"""

from itertools import combinations
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Flags, Indices, Stamps
from fej_slam_ros.core.records import NS

#: Steps back below this [ns] are the disorder of threads and buffers.
MAX_DISORDER = NS // 10
#: A step back leads to another recording if a gap in between is longer than this share of it, and
#: than any pause before.
MIN_GAP = 0.5
#: Share of the rows after a step back, and number of rows, that must be too many for their time.
MIN_SURPLUS, MIN_SURPLUS_ROWS = 0.5, 1.25
#: Relative error of the period of a log at a step back.
PERIOD_ERROR = 0.05
#: Minimum length, in rows at the mean rate, of the windows before and after a step back whose
#: rates are compared.
NEARBY_ROWS = 20
#: Share of the rows of a window that rows before and after must each have to be compared there,
#: and minimum number of such windows.
MIN_OF_BOTH, MIN_WINDOWS = 0.25, 3
#: Maximum number of rows after a step back that give the period of the log there.
MAX_NEXT_ROWS = 1000
#: Maximum number of parts into which a log is divided; more are disorder of another kind.
MAX_PARTS = 100
#: Steps longer than this multiple of the median step are gaps; the mean rate leaves them out.
GAP_STEPS = 10.0
#: Maximum number of periods between two successive rows of a regular log.
MAX_PERIODS = 3.0
#: Number of successive jumps searched for two swapped blocks, which cause three; a step of the
#: clock may add one.
MAX_JUMPS = 4


def steps_back(stamps: Stamps) -> list[int]:
    """Return the rows (in order of recording) whose stamps are far before the previous one's."""
    back: list[int] = np.flatnonzero(np.diff(stamps) <= -MAX_DISORDER).tolist()
    return [row + 1 for row in back]


def period(stamps: Stamps) -> float:
    """Return the mean step [ns] of a log without its gaps; 0 if no stamp follows another."""
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    return float(steps[steps <= GAP_STEPS * np.median(steps)].mean()) if len(steps) else 0.0


def _longest_step(step: float) -> float:
    """Return the longest step [ns] between two successive rows of a log of a mean step."""
    return max(MAX_PERIODS * step, MAX_DISORDER)


def recorded_order(stamps: Stamps) -> Indices:
    """
    Return the order in which rows were recorded, where blocks of them were written late.

    Two blocks in the wrong order leave three jumps, and each continues the rows next to the other.
    Their own order says on which side of a step of the clock they were recorded; sorted by stamp,
    it is lost.
    """
    order = np.arange(len(stamps))
    longest = _longest_step(period(stamps))
    steps = np.diff(stamps)
    jumps = (np.flatnonzero((steps <= -MAX_DISORDER) | (steps > longest)) + 1).tolist()
    end = 0
    for first, *later in (jumps[k:k + MAX_JUMPS] for k in range(len(jumps))):
        for middle, last in combinations(later, 2):
            joints = stamps[middle] - stamps[first - 1], stamps[last] - stamps[middle - 1]
            if first >= end and all(-MAX_DISORDER <= joint <= longest for joint in joints):
                order[first:last] = np.roll(order[first:last], first - middle)
                end = last
    return order


def breaks(stamps: Stamps) -> list[int]:
    """
    Return the rows at which a log continues with another clock, or another recording.

    The log is divided at the step back where its rows mix most, then both parts again, but no
    further than into `MAX_PARTS`.
    """
    if np.sign(np.diff(stamps)).sum() < 0:
        return []  # in reverse, as tables that begin with the newest row
    # Sorted, a log that is in no order has its period, and one that is there twice, half of it.
    step = min(period(stamps) or np.inf, 2.0 * period(np.sort(stamps)))
    found, parts = list[int](), [(0, len(stamps))]
    while parts and len(found) < MAX_PARTS - 1:
        begin, end = parts.pop()
        if row := _break(stamps[begin:end], step):
            found.append(begin + row)
            parts += [(begin + row, end), (begin, begin + row)]
    return sorted(found)


def _break(stamps: Stamps, step: float) -> int:
    """Return the step back where rows before and after mix most, 0 if all are of one clock."""
    order = np.argsort(stamps, kind='stable')
    in_order = stamps[order]
    pauses = np.maximum.accumulate(np.diff(stamps, prepend=stamps[:1]))  # up to rows
    worst, most = 0, -1
    for row in steps_back(stamps):
        low, high = stamps[[row, row - 1]].tolist()
        around = slice(*np.searchsorted(in_order, [low, high + 1]).tolist())
        times, is_later = in_order[around], order[around] >= row
        if np.diff(times).max() > max(MIN_GAP * (high - low), MAX_PERIODS * step, pauses[row]):
            return row
        changes = int(np.count_nonzero(np.diff(is_later)))
        if changes > most and _are_too_many(
                stamps, row, in_order, times, is_later, step):
            worst, most = row, changes
    return worst


def _are_too_many(
    stamps: Stamps, row: int, in_order: Stamps, times: Stamps, is_later: Flags, step: float
) -> bool:
    """Return whether rows before and after a step back alternate, and are too many for the log."""
    passed = _passed(times, is_later, step)
    if not passed.is_mixed:
        return False
    here = _local_period(stamps, row, in_order, step)
    return _is_dense(in_order, passed, row, here) or _is_doubled(times, is_later, here)


class _PassedTime(NamedTuple):
    """Time [ns] that rows before and after a step back may both pass; empty if begin > end."""

    begin: int
    end: int
    is_whole: bool  #: whether it ends where the stamps stepped back, as after a clock was set
    is_mixed: bool  #: whether rows before and after alternate all the time in it


def _passed(times: Stamps, is_later: Flags, step: float) -> _PassedTime:
    """
    Return the time that rows before and after a step back both pass.

    It is part of `times`, the sorted stamps from that after the step back to that before it: from
    the first row before to the last one after, or to the ends of `times` where these are near.
    """
    low, high = int(times[0]), int(times[-1])
    longest = _longest_step(step)
    begin, end = int(times[~is_later][0]), int(times[is_later][-1])
    within = is_later[(begin <= times) & (times <= end)]
    changes, later = int(np.count_nonzero(np.diff(within))), int(np.count_nonzero(within))
    is_whole = end >= high - longest
    return _PassedTime(
        low if begin <= low + longest else begin, high if is_whole else end, is_whole,
        2 * changes >= max(later, len(within) - later))


def _is_dense(in_order: Stamps, passed: _PassedTime, before: int, period: float) -> bool:
    """Return whether a time has more rows than the period allows; `before` rows may repeat it."""
    begin, end, is_whole, _ = passed
    first = max(int(np.searchsorted(in_order, begin, 'left')) - 1, 0)
    last = min(int(np.searchsorted(in_order, end, 'right')), len(in_order) - 1)
    # From the row before to the row after, since the ends are at no regular times.
    around = min(begin - int(in_order[first]), period) + min(int(in_order[last]) - end, period)
    surplus = last - first - (end - begin + around) / period
    regular = (end - begin) / period + 1.0
    return begin <= end and surplus >= max(
        MIN_SURPLUS_ROWS if is_whole else NEARBY_ROWS, MIN_SURPLUS * min(regular, before),
        PERIOD_ERROR * regular)


def _is_doubled(times: Stamps, is_later: Flags, period: float) -> bool:
    """Return whether there are too many rows wherever there are some of before and of after."""
    windows = ((times - times[0]) / (NEARBY_ROWS * period)).astype(np.int64)
    counts = [np.bincount(windows[part], minlength=windows[-1] + 1) for part in (
        is_later, ~is_later)]
    has_both = np.minimum(*counts) >= MIN_OF_BOTH * NEARBY_ROWS
    regular = NEARBY_ROWS * np.count_nonzero(has_both)
    return bool(
        regular >= MIN_WINDOWS * NEARBY_ROWS
        and np.add(*counts)[has_both].sum() >= (1.0 + MIN_SURPLUS) * regular)


def _local_period(stamps: Stamps, row: int, in_order: Stamps, step: float) -> float:
    """Return the period [ns] of a log, whose rate may change, at a step back."""
    low, high = stamps[[row, row - 1]].tolist()
    nearby = max(high - low, NEARBY_ROWS * step)
    around: list[float] = []
    for begin, end in (
            (max(low - nearby, int(in_order[0])), low),
            (high, min(high + nearby, int(in_order[-1])))):
        count = int(np.searchsorted(in_order, end, 'left') - np.searchsorted(
            in_order, begin, 'right'))
        if count >= NEARBY_ROWS // 2:
            around.append((end - begin) / (count + 1.0))
    own = _period_of_next(stamps[row:row + MAX_NEXT_ROWS], high)
    if not own:
        return min([step, *around])
    return min(own, max(around, default=own if own < MAX_PERIODS * step else 0.5 * step))


def _period_of_next(stamps: Stamps, high: int) -> float:
    """Return the period [ns] of the rows after a step back from a stamp; 0 if they are few."""
    if len(stamps) < NEARBY_ROWS:
        return 0.0
    ascending = stamps[:([*steps_back(stamps), len(stamps)])[0]]
    ascending = ascending[ascending <= high]
    if len(ascending) >= NEARBY_ROWS:
        return period(ascending)
    # Far from each other, successive rows are in no order.
    return max(float(np.median(np.diff(np.sort(stamps[:NEARBY_ROWS])))), 1.0)
