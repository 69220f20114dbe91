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
        # Number and delay of the messages of each robot that are faster than all later ones, so
        # that the first is the fastest and the last the newest.
        self._fastest: defaultdict[str, deque[tuple[int, int]]] = defaultdict(deque)

    def add(self, robot: str, delay: int) -> None:
        """Add the delay [ns] of a message."""
        fastest = self._fastest[robot]
        number = fastest[-1][0] + 1 if fastest else 1
        while fastest and fastest[-1][1] >= delay:
            fastest.pop()
        fastest.append((number, delay))
        if fastest[0][0] <= number - MAX_DELAYS:
            fastest.popleft()

    def remove_robot(self, robot: str) -> None:
        """Delete the delays of a robot that was removed."""
        self._fastest.pop(robot, None)

    def delay(self, robot: str) -> int | None:
        """Return the smallest recent delay [ns], None without messages."""
        return self._fastest[robot][0][1] if robot in self._fastest else None

    def offset(self, robot: str) -> int | None:
        """Return how far [ns] a robot's clock is ahead of the others', None if unknown."""
        own = self.delay(robot)
        others = [fastest[0][1] for other, fastest in self._fastest.items() if other != robot]
        return None if own is None or not others else round(median(others) - own)
