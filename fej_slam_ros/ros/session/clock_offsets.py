# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clock offsets between robots, estimated from the delays of their messages."""

from collections import defaultdict, deque
from statistics import median

#: Number of the latest messages of each robot whose delays count: a few seconds of odometry, so
#: that a corrected clock shows.
MAX_DELAYS = 200


class ClockOffsets:
    """
    Delays from stamp to reception, and the clock offsets that follow from them.

    The smallest delay in a window is the shortest transport time minus the offset of the robot's
    clock; the transport time is much the same for all robots.

    """

    def __init__(self) -> None:
        self._delays: defaultdict[str, deque[int]] = defaultdict(lambda: deque(maxlen=MAX_DELAYS))

    def add(self, robot: str, delay: int) -> None:
        """Add the delay [ns] of a message."""
        self._delays[robot].append(delay)

    def remove_robot(self, robot: str) -> None:
        """Delete the delays of a robot that was removed."""
        self._delays.pop(robot, None)

    def delay(self, robot: str) -> int | None:
        """Return the smallest recent delay [ns], None without messages."""
        return min(self._delays[robot]) if robot in self._delays else None

    def offset(self, robot: str) -> int | None:
        """Return how far [ns] a robot's clock is ahead of the others', None if unknown."""
        own = self.delay(robot)
        others = [min(delays) for other, delays in self._delays.items() if other != robot]
        return None if own is None or not others else round(median(others) - own)
