# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Detection of lost robots and moved landmarks from observations that fail the gate.

If most of a scan fails, the robot's pose is suspected; if one landmark fails again and again among
others that pass, the landmark.
"""

from collections.abc import Callable, Container, Iterable, Mapping, Sequence

from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, CONTRADICTION_D2, ScanGateStatistics
from fej_slam_ros.core.ekf.state import JointState, Landmark, MovedLandmarkEvidence, Robot
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.rejections import Rejection, RejectionReason

#: Number of consecutive scans that mostly failed after which a robot counts as lost.
LOST_AFTER = 3
#: Number of observations in such scans that must contradict the map before the robot restarts,
#: and of scans that are kept. Small scans also fail where an overconfident robot closes a loop.
MIN_CONTRADICTIONS = 9
MAX_FAILED_SCANS = 9

#: Number of scans in a row that cannot tell whether a suspected robot is where it is estimated,
#: after which it maps again. Otherwise one wrong scan before unknown ground would end its map.
MAX_INCONCLUSIVE = 10

#: Number of scans in a row that must fit the map of its own frame before a lost robot may join.
PROBATION = 20

#: Minimum number of other landmarks in a scan by which the robot's pose is checked.
MIN_OTHERS = 2

#: The gate's results on the scans of an update, by robot.
Scans = Mapping[str, ScanGateStatistics]


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
        self._restarted: dict[str, str] = {}
        self._probation: dict[str, int] = {}

    def add(self, scans: Scans) -> None:
        """Add the scans of one update."""
        for robot, scan in scans.items():
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


def update_trust(
    state: JointState, innovation: Innovation, scans: Scans, stamp: int
) -> list[Rejection]:
    """
    Trust the landmarks of scans that confirm the robot's pose; remove what other scans started.

    A robot that is not where it is estimated starts landmarks that fit its pose and nothing else.
    They are not trusted, for they were never observed together with landmarks that are. Returns
    the observations that started what is removed as rejected.

    """
    confirmed = {name for name, scan in scans.items() if scan.confirms_pose()}
    for a in innovation.used:
        if isinstance(a.observed, Landmark):
            a.observed.is_reobserved = True
            if a.observer.name in confirmed:
                a.observed.is_trusted = True
    suspected = [name for name, scan in scans.items() if scan.mostly_failed()]
    started = [
        landmark for landmark in state.landmarks.values()
        if landmark.owner in suspected and landmark.created == stamp] if suspected else []
    state.remove_all(started)
    return [
        Rejection(landmark.owner, stamp, RejectionReason.LOST_ROBOT, id=landmark.key[1])
        for landmark in started]


def remove_contradicted(
    state: JointState, innovation: Innovation, scans: Scans
) -> list[Rejection]:
    """
    Remove landmarks whose second observation contradicts the first; return that as rejected.

    One of the two is wrong, such as a misread tag. The next observation starts the landmark again.

    """
    contradicted: dict[LandmarkKey, Landmark] = {}
    for gated in innovation.rejected:
        observer, observed, _ = gated.association
        is_robot_suspected = observer.name in scans and scans[observer.name].mostly_failed()
        if (isinstance(observed, Landmark) and not observed.is_reobserved
                and gated.d2 > CONTRADICTION_D2 and not is_robot_suspected
                and observed.key in state.landmarks):
            contradicted[observed.key] = observed
    state.remove_all([*contradicted.values()])
    return [
        Rejection(landmark.owner, landmark.created, RejectionReason.GATED, id=landmark.key[1])
        for landmark in contradicted.values()]


def remove_untrusted(state: JointState, robot: str) -> None:
    """Remove the landmarks that a lost robot has started and nothing confirms."""
    state.remove_all([
        landmark for landmark in state.landmarks.values()
        if landmark.owner == robot and not landmark.is_trusted])


def ignore(state: JointState, innovation: Innovation, scans: Scans) -> None:
    """Do not look for moved landmarks."""


def report(state: JointState, innovation: Innovation, scans: Scans) -> None:
    """Collect evidence for each landmark until one of its observations passes the gate."""
    failed = {name for name, scan in scans.items() if scan.mostly_failed()}
    for a in innovation.used:
        if a.observer.name not in failed and isinstance(a.observed, Landmark):
            a.observed.last_accepted, a.observed.moved_evidence = a.observer.stamp, None
    if not innovation.rejected:
        return
    passed = _of_landmarks(a for a in innovation.used if a.observer.name not in failed)
    rejected = _of_landmarks(gated.association for gated in innovation.rejected)
    suspects = _of_landmarks(
        gated.association for gated in innovation.rejected if gated.d2 > CONTRADICTION_D2)
    for robot, landmark in suspects:
        if _pose_is_confirmed(robot, landmark, passed, rejected):
            landmark.moved_evidence = landmark.moved_evidence or MovedLandmarkEvidence()
            landmark.moved_evidence.add(robot.name, state.estimate(robot)[:2])


def forget(state: JointState, innovation: Innovation, scans: Scans) -> None:
    """Remove moved landmarks, so that the next observation starts them at their new position."""
    report(state, innovation, scans)
    moved = {
        landmark.key: landmark
        for _, landmark in _of_landmarks(gated.association for gated in innovation.rejected)
        if landmark.was_moved() and landmark.key in state.landmarks}
    state.remove_all([*moved.values()])


#: The values of parameter `moved_landmarks`.
MOVED_LANDMARKS: Mapping[str, Callable[[JointState, Innovation, Scans], None]] = {
    'report': report, 'forget': forget, 'ignore': ignore}


def _of_landmarks(associations: Iterable[Association]) -> list[tuple[Robot, Landmark]]:
    """Return the observers with the landmarks that they observed."""
    return [(a.observer, a.observed) for a in associations if isinstance(a.observed, Landmark)]


def _pose_is_confirmed(
    robot: Robot, landmark: Landmark, passed: Sequence[tuple[Robot, Landmark]],
    rejected: Sequence[tuple[Robot, Landmark]],
) -> bool:
    """
    Return whether most other landmarks of the scan confirm the robot's pose.

    Only landmarks older than the last accepted observation of this one count: those that the robot
    started since then share the error of its pose.

    """
    right, wrong = (
        sum(observer is robot and other is not landmark and other.created <= landmark.last_accepted
            for observer, other in some)
        for some in (passed, rejected))
    return right + wrong >= MIN_OTHERS and right > wrong
