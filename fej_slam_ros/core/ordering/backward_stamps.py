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
#: Number of rows in a span of stamps, relative to a regular log: with fewer than MIN_DENSITY the
#: span has a gap, with more than MAX_DENSITY (and at least MIN_ROWS rows) it was passed twice.
MIN_DENSITY, MAX_DENSITY, MIN_ROWS = 0.5, 1.5, 4
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
    back, order = steps_back(stamps), np.argsort(stamps, kind='stable')
    for row in back:
        changes = _changes(stamps, row, order, step)
        if changes > most:
            worst, most = row, changes
        if most == np.inf:
            break
    return worst


def _changes(stamps: Stamps, row: int, order: Indices, step: float) -> float:
    """
    Return how often rows before and after a step back alternate in the order of stamps.

    It is inf if the rows leave a gap, and above `MAX_CHANGES` if the stamps pass the time twice.
    """
    def rows_between(low: float, high: float) -> Indices:
        begin = np.searchsorted(stamps, low, 'right', sorter=order)
        return order[begin:np.searchsorted(stamps, high, 'left', sorter=order)]

    low, high = float(stamps[row]), float(stamps[row - 1])
    length, between = high - low, rows_between(low, high)
    if (len(between) + 1) * step < MIN_DENSITY * length:
        return np.inf
    changes = float(np.count_nonzero(np.diff(between < row)))
    # The rate of the log may change, so it is also compared with that just before and after.
    nearby = max(length, NEARBY_ROWS * step)
    densest = max(length / step, *(
        len(rows_between(begin, begin + nearby)) * length / nearby
        for begin in (low - nearby, high)))
    is_dense = len(between) >= max(MIN_ROWS, MAX_DENSITY * densest - 1.0)
    return max(changes, MAX_CHANGES + 1.0) if is_dense else changes
