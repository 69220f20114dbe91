# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The account of all inputs: nothing is used or refused without being counted."""

from collections import Counter, defaultdict, deque

from fej_slam_ros.core.records import Refusal, Rejection

#: How many rejections are kept to be told; what is older was counted all the same.
KEPT = 1000


class Ledger:
    """
    What became of every message and every sighting.

    Attributes
    ----------
    received : messages of each robot, whatever became of them
    refused : messages of each robot that were refused as a whole
    sightings_used : sightings of each robot that started or corrected something
    sightings_relaxed : how many of them were used with more noise than they had
    refusals : for each robot, how many messages or single sightings were refused for a reason
    rejections : the newest of them, until somebody takes them to tell
    released_without : steps of each robot that came after others had been taken further
    located_anew : how often each robot came to a place that its odometry does not tell
    longest_delay : by how much [ns] late data of each robot came too late, at most

    """

    def __init__(self) -> None:
        self.received: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.sightings_used: Counter[str] = Counter()
        self.sightings_relaxed: Counter[str] = Counter()
        self.refusals: defaultdict[str, Counter[Refusal]] = defaultdict(Counter)
        self.rejections: deque[Rejection] = deque(maxlen=KEPT)
        self.released_without: Counter[str] = Counter()
        self.located_anew: Counter[str] = Counter()
        self.longest_delay: Counter[str] = Counter()

    def refuse(self, rejection: Rejection) -> None:
        """Count a refused message, or a refused sighting where the rejection names a landmark."""
        robot = rejection.robot
        self.refusals[robot][rejection.reason] += 1
        self.refused[robot] += rejection.id is None
        self.longest_delay[robot] = max(self.longest_delay[robot], rejection.delay or 0)
        self.rejections.append(rejection)

    def turn_away(self, robot: str, stamp: int, reason: Refusal) -> None:
        """Count a message of a stamp [ns] that is received only to be refused."""
        self.received[robot] += 1
        self.refuse(Rejection(robot, stamp, reason))

    def count_spoilt(self, robot: str) -> None:
        """Count a message of which every single sighting was refused."""
        self.received[robot] += 1
        self.refused[robot] += 1

    def total(self, reason: Refusal) -> int:
        """Return how often inputs of all robots were refused for a reason."""
        return sum(counts[reason] for counts in self.refusals.values())

    def depends_on_arrival(self) -> bool:
        """Return whether another order of arrival might have given another result."""
        return self.released_without.total() > 0 or any(
            self.total(reason) for reason in (Refusal.LATE, Refusal.CONFLICTING))
