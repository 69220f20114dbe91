# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of lost robots: most of their scans fail the gate, or fit several places."""

from collections.abc import Container
from dataclasses import dataclass

from fej_slam_ros.core.ekf.gating import MIN_KNOWN, ScanGateStatistics, StatisticsByRobot

#: Number of consecutive scans that mostly failed after which a robot counts as lost.
LOST_AFTER = 3
#: Number of observations in such scans that must contradict the map before the robot restarts,
#: and of scans that are kept. Small scans also fail where an overconfident robot closes a loop.
MIN_CONTRADICTIONS = 9
MAX_FAILED_SCANS = 9

#: Share of the landmarks without ID that should be in view that a lost robot misses.
MISSED_BY_LOST = 0.8

#: Number of inconclusive scans in a row of a suspected robot after which it maps again. Otherwise
#: one wrong scan before unknown ground would end its map.
MAX_INCONCLUSIVE = 10

#: Numbers of scans and of observations without ID in a row that all fit several landmarks, after
#: which a robot restarts. Where a robot is not lost, two such scans in a row are rare.
AMBIGUOUS_SCANS, AMBIGUOUS_OBSERVATIONS = 5, 15

#: Number of scans in a row that must fit the map of its own frame before a lost robot may join.
PROBATION = 20


@dataclass(frozen=True, slots=True)
class ScanMatchStatistics:
    """Numbers of observations without ID and of confirmed landmarks in a scan."""

    used: int = 0  #: observations of existing landmarks, or with IDs
    doubtful: int = 0  #: ambiguous observations
    elsewhere: int = 0  #: observations where no confirmed landmark is
    expected: int = 0  #: landmarks that should be in view
    missed: int = 0  #: those among them that were not observed

    def is_conclusive(self) -> bool:
        """Return whether enough landmarks should be in view to check the robot's pose."""
        return self.expected >= MIN_KNOWN

    def mostly_failed(self) -> bool:
        """Return whether the robot observes others than the landmarks that should be in view."""
        return self.is_conclusive() and self.elsewhere >= MIN_KNOWN and (
            self.missed >= MISSED_BY_LOST * self.expected)


class LostRobotDetector:
    """
    Detects robots that are likely lost.

    A robot is lost if most observations of each of its latest conclusive scans failed the gate, or
    were of others than the landmarks in view. It has left ``map`` then, and is on probation: it
    may join again after some scans that fit the map of its own frame.

    """

    def __init__(self) -> None:
        self._failed: dict[str, list[ScanGateStatistics]] = {}
        self._inconclusive: dict[str, int] = {}
        self._ambiguous: dict[str, tuple[int, int]] = {}
        # Whose last scan missed most landmarks without ID: that it fits others clears nothing.
        self._misses_most: set[str] = set()
        self._restarted: dict[str, str] = {}
        self._probation: dict[str, int] = {}

    def add(self, statistics: StatisticsByRobot) -> None:
        """Add the scans of one update."""
        for robot, scan in statistics.items():
            if scan.mostly_failed():
                self._add_failed(robot, scan)
            elif robot not in self._misses_most and (
                    scan.is_conclusive() or scan.confirms_pose()):
                self.forget_scans(robot)
            elif self.is_suspected(robot):
                self.add_inconclusive(robot)
            if robot in self._probation:
                self._continue_probation(robot, scan)

    def add_matches(self, robot: str, scan: ScanMatchStatistics) -> None:
        """Add a scan of observations without ID."""
        self._misses_most.discard(robot)
        if scan.mostly_failed():
            self._misses_most.add(robot)
            self._add_failed(robot, ScanGateStatistics(scan.expected, scan.missed))
        elif scan.used and scan.is_conclusive():
            self.forget_scans(robot)
        if scan.used:
            self._ambiguous.pop(robot, None)
        elif scan.doubtful:
            scans, observations = self._ambiguous.get(robot, (0, 0))
            self._ambiguous[robot] = scans + 1, observations + scan.doubtful

    def _add_failed(self, robot: str, scan: ScanGateStatistics) -> None:
        self._failed.setdefault(robot, []).append(scan)
        del self._failed[robot][:-MAX_FAILED_SCANS]
        self._inconclusive.pop(robot, None)

    def add_inconclusive(self, robot: str) -> None:
        """Add a scan of a suspected robot with too few known landmarks to check its pose."""
        self._inconclusive[robot] = self._inconclusive.get(robot, 0) + 1
        if self._inconclusive[robot] == MAX_INCONCLUSIVE:
            self.forget_scans(robot)

    def restart(self, robot: str) -> None:
        """Begin the probation of a lost robot that restarts in its own frame."""
        self._restarted[robot] = self.reason(robot) or ''
        self._probation[robot] = PROBATION
        self.forget_scans(robot)

    def mark_found(self, in_map: Container[str]) -> None:
        """Clear the evidence against the robots that were lost and are in ``map`` again."""
        for robot in [robot for robot in self._restarted if robot in in_map]:
            self.reset(robot)

    def reset(self, robot: str) -> None:
        """Clear the evidence that a robot is lost."""
        self.forget_scans(robot)
        self._restarted.pop(robot, None)
        self._probation.pop(robot, None)

    def forget_scans(self, robot: str) -> None:
        """End the suspicion that a robot is lost."""
        self._ambiguous.pop(robot, None)
        self._failed.pop(robot, None)
        self._inconclusive.pop(robot, None)

    def is_suspected(self, robot: str) -> bool:
        """Return whether most of a scan of a robot failed, and none since has cleared it."""
        return robot in self._failed

    def must_restart(self, robot: str) -> bool:
        """Return whether enough scans in a row mostly failed."""
        scans = self._failed.get(robot, [])
        return len(scans) >= LOST_AFTER and (
            sum(scan.failed for scan in scans) >= MIN_CONTRADICTIONS)

    def ambiguous(self, robot: str) -> int:
        """Return how many observations in a row fit several places, 0 until they are enough."""
        scans, observations = self._ambiguous.get(robot, (0, 0))
        is_enough = scans >= AMBIGUOUS_SCANS and observations >= AMBIGUOUS_OBSERVATIONS
        return observations if is_enough else 0

    def on_probation(self) -> dict[str, str]:
        """Return why robots that were lost may not join ``map`` yet."""
        return {
            robot: f'it was lost: {remaining} more scans must fit the map of its own frame'
            for robot, remaining in self._probation.items()}

    def reason(self, robot: str) -> str | None:
        """Return why a robot counts as lost, None if it does not."""
        scans = self._failed.get(robot, [])[-LOST_AFTER:]
        if len(scans) < LOST_AFTER:
            return self._restarted.get(robot)
        failed, known = sum(scan.failed for scan in scans), sum(scan.known for scan in scans)
        what = 'landmarks in view missed' if robot in self._misses_most else 'observations gated'
        return f'{failed} of {known} {what} in a row'

    def _continue_probation(self, robot: str, scan: ScanGateStatistics) -> None:
        if scan.mostly_failed():
            self._probation[robot] = PROBATION
        elif scan.known and 2 * scan.failed <= scan.known:
            self._probation[robot] -= 1
            if not self._probation[robot]:
                del self._probation[robot]
