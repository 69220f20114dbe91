# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of landmarks without ID from several sensors of a robot."""

from collections import deque

#: Maximum number of sensors of a robot whose data may have the same stamps.
MAX_SENSORS = 16


class DistinctStamps:
    """
    Stamps of landmarks, those from several sensors at one time a nanosecond apart.

    The estimator takes the observations of one step for those of different landmarks, while two
    sensors may see the same one.
    """

    def __init__(self) -> None:
        self._latest: deque[int] = deque(maxlen=MAX_SENSORS)

    def of(self, stamp: int) -> int:
        """Return the first stamp from a given one on that no latest landmarks have [ns]."""
        while stamp in self._latest:
            stamp += 1
        self._latest.append(stamp)
        return stamp
