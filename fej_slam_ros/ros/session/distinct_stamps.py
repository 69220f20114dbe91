# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Stamps of landmarks without ID from several sensors of a robot."""

from collections import deque
from collections.abc import Hashable
from operator import itemgetter

#: Maximum number of sensors of a robot whose data may have the same stamps.
MAX_SENSORS = 16


class DistinctStamps:
    """
    Stamps of landmarks, those from several sensors at one time a nanosecond apart.

    The estimator takes the observations of one step for those of different landmarks, while two
    sensors may see the same one. Data that a sensor sends twice have one stamp, by which the
    estimator knows them.
    """

    def __init__(self) -> None:
        # Stamp [ns], sensor and distinct stamp [ns] of the latest data.
        self._latest: deque[tuple[int, Hashable, int]] = deque(maxlen=MAX_SENSORS)

    def of(self, stamp: int, sensor: Hashable) -> int:
        """Return the first stamp from a given one on that no other sensor has [ns]."""
        distinct = stamp
        for given, other, published in sorted(self._latest, key=itemgetter(2)):
            if (given, other) == (stamp, sensor):
                return published
            distinct += distinct == published
        self._latest.append((stamp, sensor, distinct))
        return distinct
