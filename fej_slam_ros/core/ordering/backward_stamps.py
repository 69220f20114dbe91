# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Stamps of a regular log that step back: rows written late, or another clock.

A buffer that is written late, or logs joined in the wrong order, step back to a time of which the
log holds no other rows: sorted by stamp, the log is regular. After a clock was set back, or where
two recordings are joined, the stamps pass a time twice, in which sorted rows of two motions would
mix, or return to a time far before all others.
"""

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.records import NS

Stamps = NDArray[np.int64]
#: Steps back up to this [ns] are the disorder of threads and buffers.
MAX_DISORDER = NS // 10
#: Share of the rows of a regular log that a time holds at least.
MIN_DENSITY = 0.5
#: Number of changes between rows before and after a step back, sorted, above which these mix: a
#: block that fills a gap makes three, and disorder at its ends a few more.
MAX_CHANGES = 6
#: Longer steps, relative to the median one, are gaps and do not count for the rate.
GAP_STEPS = 10.0


def steps_back(stamps: Stamps) -> list[int]:
    """Return the rows (in order of recording) whose stamps are far before the previous one's."""
    back: list[int] = np.flatnonzero(np.diff(stamps) < -MAX_DISORDER).tolist()
    return [row + 1 for row in back]


def period(stamps: Stamps) -> float:
    """Return the mean step [ns] of a log without its gaps; 0 if no stamp follows another."""
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    return float(steps[steps <= GAP_STEPS * np.median(steps)].mean()) if len(steps) else 0.0


def breaks(stamps: Stamps) -> list[int]:
    """Return the rows at which a log continues with another clock, or another recording."""
    back = steps_back(stamps)
    return [
        row for begin, row, end in zip([0, *back], back, [*back[1:], len(stamps)])
        if not _is_regular(stamps[begin:row], stamps[row:end], stamps)]


def _is_regular(before: Stamps, after: Stamps, stamps: Stamps) -> bool:
    """Return whether a log, sorted, is regular in the time between its rows at a step back."""
    low, high = after[0], before[-1]
    between = stamps[(low < stamps) & (stamps < high)]
    if (len(between) + 1) * period(stamps) < MIN_DENSITY * float(high - low):
        return False
    order = np.argsort(np.concatenate([before, after]), kind='stable')
    changes = int(np.count_nonzero(np.diff(order < len(before))))
    return changes <= MAX_CHANGES
