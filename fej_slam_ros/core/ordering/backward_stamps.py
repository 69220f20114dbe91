# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Stamps of a regular log that step back: rows written late, or another clock.

A buffer that is written late, or logs joined in the wrong order, step back to a time of which the
log holds no other rows: sorted by stamp, the log is regular. After a clock was set back, or where
two recordings are joined, the stamps pass a time twice, in which sorted rows of two motions would
mix, or return to a time far before all others.
"""

from itertools import combinations

import numpy as np

from fej_slam_ros.core.geometry import Indices, Stamps
from fej_slam_ros.core.records import NS

#: Steps back up to this [ns] are the disorder of threads and buffers.
MAX_DISORDER = NS // 10
#: Share of the rows of a regular log below which a span of stamps has a gap, if more than
#: `MAX_PERIODS` rows are missing.
MIN_DENSITY = 0.5
#: Share of the rows that a clock set back writes too many, from which a time was passed twice.
MIN_SURPLUS = 0.5
#: Minimum length, in rows at the mean rate, of the windows before and after a step back whose
#: rates are compared.
NEARBY_ROWS = 20
#: Largest number of alternations, in the order of stamps, between rows recorded before and after a
#: step back that late rows explain: a block that fills a gap causes three, disorder a few more.
MAX_CHANGES = 6
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
    back: list[int] = np.flatnonzero(np.diff(stamps) < -MAX_DISORDER).tolist()
    return [row + 1 for row in back]


def period(stamps: Stamps) -> float:
    """Return the mean step [ns] of a log without its gaps; 0 if no stamp follows another."""
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    return float(steps[steps <= GAP_STEPS * np.median(steps)].mean()) if len(steps) else 0.0


def recorded_order(stamps: Stamps) -> Indices:
    """
    Return the order in which rows were recorded, where blocks of them were written late.

    Two blocks in the wrong order leave three jumps, and each continues the rows next to the other.
    Their own order says on which side of a step of the clock they were recorded; sorted by stamp,
    it is lost.
    """
    order = np.arange(len(stamps))
    longest = max(MAX_PERIODS * period(stamps), MAX_DISORDER)
    steps = np.diff(stamps)
    jumps = (np.flatnonzero((steps < -MAX_DISORDER) | (steps > longest)) + 1).tolist()
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
    step, found = period(stamps), list[int]()
    parts = [(0, len(stamps))]
    while parts and len(found) < MAX_PARTS - 1:
        begin, end = parts.pop()
        row = _break(stamps[begin:end], step)
        if row:
            found.append(begin + row)
            parts += [(begin + row, end), (begin, begin + row)]
    return sorted(found)


def _break(stamps: Stamps, step: float) -> int:
    """Return the row where rows before and after mix most, 0 if all are of one clock."""
    worst, most = 0, float(MAX_CHANGES)
    order = np.argsort(stamps, kind='stable')
    in_order = stamps[order]
    for row in steps_back(stamps):
        low, high = stamps[[row, row - 1]].tolist()
        between = order[_between(in_order, low, high)]
        if high - low - (len(between) + 1) * step > max(
                (1.0 - MIN_DENSITY) * (high - low), MAX_PERIODS * step):
            return row
        changes = float(np.count_nonzero(np.diff(between < row)))
        if changes <= MAX_CHANGES and _is_passed_twice(in_order, low, high, step):
            changes = MAX_CHANGES + 1.0
        if changes > most:
            worst, most = row, changes
    return worst


def _is_passed_twice(in_order: Stamps, low: int, high: int, step: float) -> bool:
    """
    Return whether ascending stamps pass the time from low to high twice, after a step back by it.

    The clock was then set back by a period more, and as many rows are too many from the row before
    low to that after high. Both may be far, as the log may have gaps there.
    """
    # The rate of the log may change, so it is also compared with that just before and after.
    nearby = max(high - low, NEARBY_ROWS * step)
    rows = (len(in_order[_between(in_order, begin, begin + nearby)])
            for begin in (low - nearby, high))
    period = min(step, *(nearby / max(count, 1) for count in rows))
    first = max(int(np.searchsorted(in_order, low, 'left')) - 1, 0)
    last = min(int(np.searchsorted(in_order, high, 'right')), len(in_order) - 1)
    elapsed = high - low + sum(
        min(distance, period) for distance in (low - in_order[first], in_order[last] - high))
    surplus = last - first - elapsed / period
    return bool(surplus >= MIN_SURPLUS * ((high - low) / period + 1.0))


def _between(in_order: Stamps, low: float, high: float) -> slice:
    """Return the ascending stamps between two times, both excluded."""
    return slice(
        int(np.searchsorted(in_order, low, 'right')), int(np.searchsorted(in_order, high, 'left')))
