# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How the clocks of the robots are set, as far as the delays of their messages tell."""

from collections import deque
from collections.abc import Iterable
from statistics import median

#: So many of the latest delays of a robot are looked at.
WINDOW = 200


class Clocks:
    """
    The delays of what robots send, from stamp to reception.

    The smallest of a window is the least that a message takes, less what the robot's clock is
    ahead of the one of reception; the former is much the same for all robots.

    Parameters
    ----------
    robots : their names

    """

    def __init__(self, robots: Iterable[str]) -> None:
        self._delays: dict[str, deque[int]] = {name: deque(maxlen=WINDOW) for name in robots}

    def add(self, robot: str, delay: int) -> None:
        """Take in the delay [ns] of a message."""
        self._delays[robot].append(delay)

    def delay(self, robot: str) -> int | None:
        """Return the smallest delay [ns] of late, None where there is none."""
        return min(self._delays[robot], default=None)

    def offset(self, robot: str) -> int | None:
        """Return how far [ns] a robot's clock is ahead of the others', if that is known."""
        own = self.delay(robot)
        others = [self.delay(other) for other in self._delays if other != robot]
        known = [delay for delay in others if delay is not None]
        return None if own is None or not known else round(median(known) - own)
