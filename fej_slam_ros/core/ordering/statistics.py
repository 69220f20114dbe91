# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The account of all inputs: nothing is used or refused without being counted."""

from collections import Counter, defaultdict, deque

from fej_slam_ros.core.rejections import Rejection, RejectionReason

#: How many rejections are kept to be told; what is older was counted all the same.
KEPT = 1000


class InputStatistics:
    """
    What became of every message and every observation.

    Attributes
    ----------
    received : messages of each robot, whatever became of them
    refused : messages of each robot that were refused as a whole
    observations_used : observations of each robot that started or corrected something
    observations_relaxed : how many of them were used with more noise than they had
    refusals : for each robot, how many messages or single observations were refused for a reason
    rejections : the newest of them, until somebody takes them to tell
    released_without : steps of each robot that came after others had been taken further
    located_anew : how often each robot came to a place that its odometry does not tell
    longest_delay : by how much [ns] late data of each robot came too late, at most

    """

    def __init__(self) -> None:
        self.received: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.observations_used: Counter[str] = Counter()
        self.observations_inflated: Counter[str] = Counter()
        self.rejection_counts: defaultdict[str, Counter[RejectionReason]] = defaultdict(Counter)
        self.rejections: deque[Rejection] = deque(maxlen=KEPT)
        self.released_without: Counter[str] = Counter()
        self.relocalized: Counter[str] = Counter()
        self.longest_delay: Counter[str] = Counter()

    def reject(self, rejection: Rejection) -> None:
        """Count a refused message, or a refused observation where the rejection names a landmark."""
        robot = rejection.robot
        self.rejection_counts[robot][rejection.reason] += 1
        self.rejected[robot] += rejection.id is None
        self.longest_delay[robot] = max(self.longest_delay[robot], rejection.delay or 0)
        self.rejections.append(rejection)

    def reject_message(self, robot: str, stamp: int, reason: RejectionReason) -> None:
        """Count a message of a stamp [ns] that is received only to be refused."""
        self.received[robot] += 1
        self.reject(Rejection(robot, stamp, reason))

    def count_empty_scan(self, robot: str) -> None:
        """Count a message of which every single observation was refused."""
        self.received[robot] += 1
        self.rejected[robot] += 1

    def total(self, reason: RejectionReason) -> int:
        """Return how often inputs of all robots were refused for a reason."""
        return sum(counts[reason] for counts in self.rejection_counts.values())

    def depends_on_arrival(self) -> bool:
        """Return whether another order of arrival might have given another result."""
        return self.released_without.total() > 0 or any(
            self.total(reason) for reason in (RejectionReason.LATE, RejectionReason.CONFLICTING))
