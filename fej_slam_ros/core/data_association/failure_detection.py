# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of lost robots: most of their scans fail the gate, or fit several places."""

from collections.abc import Container

from fej_slam_ros.core.ekf.gating import ScanGateStatistics, StatisticsByRobot

#: Number of consecutive scans that mostly failed after which a robot counts as lost.
LOST_AFTER = 3
#: Number of observations in such scans that must contradict the map before the robot restarts,
#: and of scans that are kept. Small scans also fail where an overconfident robot closes a loop.
MIN_CONTRADICTIONS = 9
MAX_FAILED_SCANS = 9

#: Number of scans in a row that cannot tell whether a suspected robot is where it is estimated,
#: after which it maps again. Otherwise one wrong scan before unknown ground would end its map.
MAX_INCONCLUSIVE = 10

#: Numbers of scans and of observations without ID in a row that all fit several landmarks, after
#: which a robot maps anew. Where a robot is not lost, two such scans in a row are rare.
AMBIGUOUS_SCANS, AMBIGUOUS_OBSERVATIONS = 5, 15

#: Number of scans in a row that must fit the map of its own frame before a lost robot may join.
PROBATION = 20


class LostRobotDetector:
    """
    Detects robots that are likely lost.

    A robot is lost if most observations of each of its latest conclusive scans failed the gate. It
    has left ``map`` then, and is on probation: it may join again after some scans that fit the map
    of its own frame.

    """

    def __init__(self) -> None:
        self._failed: dict[str, list[ScanGateStatistics]] = {}
        self._inconclusive: dict[str, int] = {}
        self._ambiguous: dict[str, tuple[int, int]] = {}
        self._restarted: dict[str, str] = {}
        self._probation: dict[str, int] = {}

    def add(self, statistics: StatisticsByRobot) -> None:
        """Add the scans of one update."""
        for robot, scan in statistics.items():
            if scan.mostly_failed():
                self._failed.setdefault(robot, []).append(scan)
                del self._failed[robot][:-MAX_FAILED_SCANS]
                self._inconclusive.pop(robot, None)
            elif scan.is_conclusive() or scan.confirms_pose():
                self.forget_scans(robot)
            elif self.is_suspected(robot):
                self.add_inconclusive(robot)
            if robot in self._probation:
                self._continue_probation(robot, scan)

    def add_matches(self, robot: str, doubtful: int, used: int) -> None:
        """Add a scan of which some observations were doubtful, and some were used."""
        if used:
            self._ambiguous.pop(robot, None)
        elif doubtful:
            scans, observations = self._ambiguous.get(robot, (0, 0))
            self._ambiguous[robot] = scans + 1, observations + doubtful

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
        return f'{failed} of {known} observations gated in a row'

    def _continue_probation(self, robot: str, scan: ScanGateStatistics) -> None:
        if scan.mostly_failed():
            self._probation[robot] = PROBATION
        elif scan.known and 2 * scan.failed <= scan.known:
            self._probation[robot] -= 1
            if not self._probation[robot]:
                del self._probation[robot]
