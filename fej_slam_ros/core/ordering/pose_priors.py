# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is said of where robots are, until they have a step from then on."""

from bisect import insort
from collections.abc import Iterator

from fej_slam_ros.core.ordering.robot_queue import REMEMBERED
from fej_slam_ros.core.records import fingerprint, PosePrior
from fej_slam_ros.core.rejections import Rejection, RejectionReason

#: So many poses that a robot was given wait for its next step.
MAX_WAITING = 100


class PosePriors:
    """
    The poses that robots were given, each of which counts once.

    A robot that leaves and comes back is not told again what it was told before.

    """

    def __init__(self) -> None:
        self._waiting: dict[str, list[PosePrior]] = {}
        self._told: dict[str, dict[int, None]] = {}

    def add(self, given: PosePrior) -> Rejection | None:
        """Take in a pose; return what is refused for it: itself, or one that waits in vain."""
        told = self._told.setdefault(given.robot, {})
        if fingerprint(given) in told:
            return Rejection(given.robot, given.stamp, RejectionReason.DUPLICATE)
        told[fingerprint(given)] = None
        if len(told) > REMEMBERED:
            del told[next(iter(told))]
        waiting = self._waiting.setdefault(given.robot, [])
        insort(waiting, given, key=lambda other: other.stamp)
        if len(waiting) > MAX_WAITING:
            return Rejection(given.robot, waiting.pop(0).stamp, RejectionReason.AFTER_ODOMETRY)
        return None

    def take(self, robot: str, stamp: int) -> Iterator[PosePrior]:
        """Yield the poses of a robot that are due at a stamp [ns], the oldest first."""
        waiting = self._waiting.get(robot, [])
        while waiting and waiting[0].stamp <= stamp:
            yield waiting.pop(0)

    def leave(self, robot: str) -> list[PosePrior]:
        """Take out all that waits of a robot."""
        return self._waiting.pop(robot, [])
