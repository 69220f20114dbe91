# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pose priors: initial poses that robots are given, until their next step."""

from bisect import insort
from dataclasses import replace

from fej_slam_ros.core.models import composed_increment
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.odometry_increments import split
from fej_slam_ros.core.ordering.record_memory import identity, RecordMemory
from fej_slam_ros.core.records import Motion, PosePrior
from fej_slam_ros.core.rejections import RejectionReason

#: Maximum number of pose priors of a robot that wait for its next step; users send few.
MAX_WAITING_PRIORS = 100


class PosePriors:
    """The pose priors of all robots; each is used once, also by a robot that left and returned."""

    def __init__(self, statistics: InputStatistics) -> None:
        self._statistics = statistics
        self._waiting: dict[str, list[PosePrior]] = {}
        self._memory: dict[str, RecordMemory] = {}

    def add(self, prior: PosePrior) -> RejectionReason | None:
        """Insert a prior; return the reason if it is rejected, None if it is accepted."""
        memory = self._memory.setdefault(prior.robot, RecordMemory())
        received = identity(prior)
        if memory.contains(received):
            return self._statistics.reject_record(prior, RejectionReason.DUPLICATE)
        memory.add(received)
        waiting = self._waiting.setdefault(prior.robot, [])
        insort(waiting, prior, key=_order)
        if len(waiting) <= MAX_WAITING_PRIORS:
            return None
        oldest = waiting.pop(0)
        reason = self._statistics.reject_record(oldest, RejectionReason.AFTER_ODOMETRY)
        return reason if oldest is prior else None

    def advance(self, motion: Motion, begin: int) -> None:
        """
        Move priors that were given during a motion, since its begin [ns], on to its end.

        An impossible motion tells nothing of the robot, so that it leaves them where they are.

        """
        waiting = self._waiting.get(motion.robot, []) if not motion.impossible else []
        for k, prior in enumerate(waiting):
            if begin < prior.stamp < motion.stamp:
                share = (prior.stamp - begin) / (motion.stamp - begin)
                _, (u, Q) = split(motion.u, motion.Q, share)
                pose, P = composed_increment(prior.pose, prior.P, u, Q)
                waiting[k] = replace(prior, pose=pose, P=P)

    def take(self, robot: str, stamp: int) -> list[PosePrior]:
        """Remove and return the priors of a robot up to a stamp [ns], oldest first."""
        waiting = self._waiting.get(robot, [])
        due = [prior for prior in waiting if prior.stamp <= stamp]
        del waiting[:len(due)]
        return due

    def waiting(self, robot: str) -> int:
        """Return the number of waiting priors of a robot."""
        return len(self._waiting.get(robot, ()))

    def leave(self, robot: str) -> None:
        """Reject the waiting priors of a robot that leaves."""
        for prior in self._waiting.pop(robot, []):
            self._statistics.reject_record(prior, RejectionReason.LEFT)

    def close(self) -> None:
        """Reject the priors that no odometry has reached: the input has ended."""
        for waiting in self._waiting.values():
            for prior in waiting:
                self._statistics.reject_record(prior, RejectionReason.AFTER_ODOMETRY)
            waiting.clear()


def _order(prior: PosePrior) -> tuple[int, list[float]]:
    """Return the sort key of a prior: its stamp, then its content, not the order of arrival."""
    return prior.stamp, [*prior.pose.tolist(), *prior.P.ravel().tolist()]
