# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the clocks of the robots are set, as far as the delays of their messages tell."""

from collections import defaultdict, deque
from statistics import median

#: So many of the latest delays of a robot are looked at.
WINDOW = 200


class Clocks:
    """
    The delays of what robots send, from stamp to reception.

    The smallest of a window is the least that a message takes, less what the robot's clock is
    ahead of the one of reception; the former is much the same for all robots.

    """

    def __init__(self) -> None:
        self._delays: defaultdict[str, deque[int]] = defaultdict(lambda: deque(maxlen=WINDOW))

    def add(self, robot: str, delay: int) -> None:
        """Take in the delay [ns] of a message."""
        self._delays[robot].append(delay)

    def forget(self, robot: str) -> None:
        """Forget a robot that has left."""
        self._delays.pop(robot, None)

    def delay(self, robot: str) -> int | None:
        """Return the smallest delay [ns] of late, None where there is none."""
        return min(self._delays[robot]) if robot in self._delays else None

    def offset(self, robot: str) -> int | None:
        """Return how far [ns] a robot's clock is ahead of the others', if that is known."""
        own = self.delay(robot)
        others = [min(delays) for other, delays in self._delays.items() if other != robot]
        return None if own is None or not others else round(median(others) - own)
