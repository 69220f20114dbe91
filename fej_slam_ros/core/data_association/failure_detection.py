# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Detection of lost robots.

Most of their scans fail the gate, or fit several places, or others observe them elsewhere.
"""

from collections import Counter
from collections.abc import Container
from dataclasses import dataclass, replace

from fej_slam_ros.core.ekf.consecutive_rejections import ConsecutiveRejections
from fej_slam_ros.core.ekf.gating import (
    MIN_CONTRADICTIONS, MIN_KNOWN, ScanGateStatistics, StatisticsByRobot)

#: Number of consecutive scans that mostly failed after which a robot counts as lost.
LOST_AFTER = 3
#: Number of such scans that are kept.
MAX_FAILED_SCANS = 9

#: Largest count of scans that mostly failed the gate without a contradiction, twice, less those
#: that passed, after which the last may be due to a slip of wheels: that is over after two scans.
MAX_GATED = 4

#: Share of the landmarks without ID that should be in view that a lost robot misses.
MISSED_BY_LOST = 0.8

#: Number of inconclusive scans in a row of a suspected robot after which it maps again. Otherwise
#: one wrong scan before unknown ground would end its map.
MAX_INCONCLUSIVE = 10

#: Numbers of scans and of observations without ID in a row that all fit several landmarks, after
#: which a robot restarts. Where a robot is not lost, two such scans in a row are rare.
AMBIGUOUS_SCANS, AMBIGUOUS_OBSERVATIONS = 5, 15

#: Number of observations of a robot in a row that contradict its pose, by robots that know where
#: they are, after which it restarts; as many as of landmarks in its own scans.
CONTRADICTIONS_BY_OTHERS = MIN_CONTRADICTIONS

#: Number of scans, without one that mostly fails, that must fit the map of its own frame before a
#: lost robot may join.
PROBATION = 20
#: Number of further scans after which its own map is wrong if it shares enough landmarks to join.
MAX_UNJOINED = 100


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


@dataclass(frozen=True, slots=True)
class ScanEvidence:
    """What the latest scans of a robot say about its pose."""

    failed: tuple[ScanGateStatistics, ...] = ()  #: the latest that mostly failed
    inconclusive: int = 0  #: number of inconclusive scans since then
    #: ambiguous_scans, ambiguous_observations: numbers in a row that all fit several landmarks
    ambiguous_scans: int = 0
    ambiguous_observations: int = 0
    #: whether the last scan missed most landmarks without ID: that it fits others clears nothing
    misses_most: bool = False

    def with_failed(self, scan: ScanGateStatistics) -> 'ScanEvidence':
        """Return the evidence with a further scan that mostly failed."""
        return replace(self, failed=(*self.failed, scan)[-MAX_FAILED_SCANS:], inconclusive=0)


NO_EVIDENCE = ScanEvidence()


@dataclass(slots=True)
class LostRobot:
    """A robot that was lost and is not in ``map`` again."""

    reason: str  #: why it counted as lost when it restarted in its own frame
    probation: int = PROBATION  #: number of scans that must fit before it may join
    unjoined: int = 0  #: number of scans since then

    def continue_probation(self, scan: ScanGateStatistics) -> None:
        """Add a scan: one that mostly failed begins the probation again, unless it is over."""
        if not self.probation:
            self.unjoined += 1
        elif scan.mostly_failed():
            self.probation = PROBATION
        elif scan.known and 2 * scan.gated <= scan.known:
            self.probation -= 1


class ContradictionsByOthers:
    """Observations of robots that contradict their poses, by robots that know where they are."""

    def __init__(self) -> None:
        # Whether the latest scan of known landmarks of a robot confirms its pose, and how many
        # observations in a row, by robots of which it does, contradict that of another.
        self._confirmed: dict[str, bool] = {}
        self._counts: Counter[str] = Counter()

    def add_scan(self, robot: str, scan: ScanGateStatistics) -> None:
        """Add a scan of a robot, if it has known landmarks."""
        if scan.known:
            self._confirmed[robot] = scan.confirms_pose()

    def add(self, observer: str, observed: str, contradicts: bool) -> None:
        """Add an observation of a robot, evidence if landmarks confirm the observer alone."""
        if not contradicts or self._confirmed.get(observed):
            self.forget(observed)
        elif self._confirmed.get(observer):
            self._counts[observed] += 1

    def count(self, robot: str) -> int:
        """Return how many observations in a row contradict a pose, 0 until they are enough."""
        return self._counts[robot] if self._counts[robot] >= CONTRADICTIONS_BY_OTHERS else 0

    def forget(self, robot: str) -> None:
        """Forget the observations of a robot."""
        self._counts.pop(robot, None)

    def forget_pose(self, robot: str) -> None:
        """Forget whether landmarks confirm the pose of a robot, which is another one now."""
        self._confirmed.pop(robot, None)


class LostRobotDetector:
    """
    Detects robots that are likely lost.

    A robot is lost if most observations of each of its latest conclusive scans failed the gate, or
    were of others than the landmarks in view. It has left ``map`` then, and is on probation: it
    may join again after some scans that fit the map of its own frame.

    """

    def __init__(self) -> None:
        self._evidence: dict[str, ScanEvidence] = {}
        self._lost: dict[str, LostRobot] = {}
        self.by_others = ContradictionsByOthers()  #: observations of robots, by other robots
        self.rejections = ConsecutiveRejections()  #: the latest observations by and of each robot
        # Twice the number of scans that mostly failed the gate without a contradiction, less those
        # that passed, or 0.
        self._gated: Counter[str] = Counter()

    def add(self, statistics: StatisticsByRobot) -> None:
        """Add the scans of one update."""
        for robot, scan in statistics.items():
            evidence = self._of(robot)
            if scan.mostly_failed():
                self._evidence[robot] = evidence.with_failed(scan)
            elif not evidence.misses_most and (scan.is_conclusive() or scan.confirms_pose()):
                self._forget_contradictions(robot)
            elif evidence.failed:
                self.add_inconclusive(robot)
            if scan.can_clear() and not scan.mostly_failed():
                change = 2 if scan.mostly_gated() else -1
                self._gated[robot] = max(self._gated[robot] + change, 0)
            if robot in self._lost:
                self._lost[robot].continue_probation(scan)
            self.by_others.add_scan(robot, scan)

    def add_matches(self, robot: str, scan: ScanMatchStatistics) -> None:
        """Add a scan of observations without ID."""
        evidence = replace(self._of(robot), misses_most=scan.mostly_failed())
        if evidence.misses_most:
            evidence = evidence.with_failed(ScanGateStatistics(scan.expected, scan.missed))
        elif scan.used and scan.is_conclusive():
            evidence = NO_EVIDENCE
        if scan.used:
            evidence = replace(evidence, ambiguous_scans=0, ambiguous_observations=0)
        elif scan.doubtful:
            evidence = replace(
                evidence, ambiguous_scans=evidence.ambiguous_scans + 1,
                ambiguous_observations=evidence.ambiguous_observations + scan.doubtful)
        self._evidence[robot] = evidence

    def add_inconclusive(self, robot: str) -> None:
        """Add a scan of a suspected robot with too few known landmarks to check its pose."""
        evidence = self._of(robot)
        self._evidence[robot] = replace(evidence, inconclusive=evidence.inconclusive + 1)
        if evidence.inconclusive + 1 == MAX_INCONCLUSIVE:
            self._end_suspicion(robot)

    def mark_lost(self, robot: str) -> None:
        """Put a robot on probation, with why it counts as lost; `begin_frame` is to follow."""
        self._lost[robot] = LostRobot(self.reason(robot) or '')

    def mark_found(self, in_map: Container[str]) -> None:
        """Clear the evidence against the robots that were lost and are in ``map`` again."""
        for robot in [robot for robot in self._lost if robot in in_map]:
            self.reset(robot)

    def reset(self, robot: str) -> None:
        """Clear the evidence that a robot is lost."""
        self._end_suspicion(robot)
        self._lost.pop(robot, None)

    def begin_frame(self, robot: str) -> None:
        """Forget the scans of a robot that restarts, and begin its probation, if any, again."""
        self._end_suspicion(robot)
        if robot in self._lost:
            self._lost[robot] = LostRobot(self._lost[robot].reason)

    def _end_suspicion(self, robot: str) -> None:
        """Forget all scans and observations that concern the pose of a robot."""
        self._gated.pop(robot, None)
        self.rejections.forget(robot)
        self._forget_contradictions(robot)
        self.by_others.forget_pose(robot)

    def _forget_contradictions(self, robot: str) -> None:
        self._evidence.pop(robot, None)
        self.by_others.forget(robot)

    def is_suspected(self, robot: str) -> bool:
        """Return whether most of a scan of a robot failed, and those since have not cleared it."""
        return bool(self._of(robot).failed) or self._gated[robot] > 0

    def must_restart(self, robot: str) -> bool:
        """Return whether enough scans in a row mostly failed."""
        scans = self._of(robot).failed
        return len(scans) >= LOST_AFTER and (
            sum(scan.failed for scan in scans) >= MIN_CONTRADICTIONS)

    def ambiguous(self, robot: str) -> int:
        """Return how many observations in a row fit several places, 0 until they are enough."""
        evidence = self._of(robot)
        observations = evidence.ambiguous_observations
        is_enough = (
            evidence.ambiguous_scans >= AMBIGUOUS_SCANS and observations >= AMBIGUOUS_OBSERVATIONS)
        return observations if is_enough else 0

    def may_have_slipped(self, robot: str) -> bool:
        """Return whether a slip may be why the latest scan of a robot mostly failed the gate."""
        return robot not in self.on_probation() and self._gated[robot] <= MAX_GATED

    def remains_unjoined(self, robot: str) -> bool:
        """Return whether a lost robot has not joined for long after its probation."""
        return robot in self._lost and self._lost[robot].unjoined >= MAX_UNJOINED

    def on_probation(self) -> dict[str, str]:
        """Return why robots that were lost may not join ``map`` yet."""
        return {
            robot: f'it was lost: {lost.probation} more scans must fit the map of its own frame'
            for robot, lost in self._lost.items() if lost.probation}

    def reason(self, robot: str) -> str | None:
        """Return why a robot counts as lost, None if it does not."""
        evidence = self._of(robot)
        scans = evidence.failed[-LOST_AFTER:]
        if len(scans) < LOST_AFTER:
            return self._lost[robot].reason if robot in self._lost else None
        failed, known = sum(scan.failed for scan in scans), sum(scan.known for scan in scans)
        what = 'landmarks in view missed' if evidence.misses_most else 'observations gated'
        return f'{failed} of {known} {what} in a row'

    def _of(self, robot: str) -> ScanEvidence:
        return self._evidence.get(robot, NO_EVIDENCE)
