# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose priors: initial poses that robots are given, until their next step."""

from bisect import insort
from collections.abc import Iterator

from fej_slam_ros.core.ordering.record_memory import identity, RecordMemory
from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.core.rejections import Rejection, RejectionReason

#: Maximum number of pose priors of a robot that wait for its next step; users send few.
MAX_WAITING_PRIORS = 100


class PosePriors:
    """The pose priors of all robots; each is used once, also by a robot that left and returned."""

    def __init__(self) -> None:
        self._waiting: dict[str, list[PosePrior]] = {}
        self._memory: dict[str, RecordMemory] = {}

    def add(self, prior: PosePrior) -> Rejection | None:
        """Insert a prior; return its rejection, or that of the oldest one beyond the maximum."""
        memory = self._memory.setdefault(prior.robot, RecordMemory())
        received = identity(prior)
        if memory.contains(received):
            return Rejection(prior.robot, prior.stamp, RejectionReason.DUPLICATE)
        memory.add(received, may_forget=lambda _: True)
        waiting = self._waiting.setdefault(prior.robot, [])
        insort(waiting, prior, key=_order)
        if len(waiting) > MAX_WAITING_PRIORS:
            return Rejection(prior.robot, waiting.pop(0).stamp, RejectionReason.AFTER_ODOMETRY)
        return None

    def take(self, robot: str, stamp: int) -> Iterator[PosePrior]:
        """Yield and remove the priors of a robot up to a stamp [ns], oldest first."""
        waiting = self._waiting.get(robot, [])
        while waiting and waiting[0].stamp <= stamp:
            yield waiting.pop(0)

    def leave(self, robot: str) -> list[PosePrior]:
        """Remove and return the waiting priors of a robot."""
        return self._waiting.pop(robot, [])


def _order(prior: PosePrior) -> tuple[int, list[float]]:
    """Return what sorts priors: the stamp, then the content, never the order of arrival."""
    return prior.stamp, [*prior.pose.tolist(), *prior.P.ravel().tolist()]
