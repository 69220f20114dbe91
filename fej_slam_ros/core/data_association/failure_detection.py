# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What observations that fail the gate tell in the long run: a robot is lost, or a landmark was moved.

Where most of a scan fails, rather the robot is wrong; where one landmark fails again and again
among others that pass, rather the landmark is.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

from scipy.special import chdtri

from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, ScanGateStatistics
from fej_slam_ros.core.ekf.state import JointState, Landmark, MovedLandmarkEvidence, Robot

#: A robot is likely lost when so many scans in a row have mostly failed.
LOST_AFTER = 3

#: A scan says something of one landmark when it shows so many others, most of which pass.
MIN_OTHERS = 2

#: No right observation has such a squared distance. To be beyond the gate is not enough: where the
#: map is uncertain, all observations of a visit are beyond it or none.
FAR = float(chdtri(2, 1e-9))


class LostRobotDetector:
    """
    Tells which robots are likely lost.

    A robot is, when of each of its last scans with enough known landmarks most has failed the
    gate.

    """

    def __init__(self) -> None:
        self._failed: dict[str, list[ScanGateStatistics]] = {}

    def add(self, scan_gate_statistics: Mapping[str, ScanGateStatistics]) -> None:
        """Take in the scans of one update."""
        for robot, look in scan_gate_statistics.items():
            if look.mostly_failed():
                self._failed.setdefault(robot, []).append(look)
                del self._failed[robot][:-LOST_AFTER]
            elif look.is_conclusive():
                self.forget(robot)

    def forget(self, robot: str) -> None:
        """Let a robot not be lost any more."""
        self._failed.pop(robot, None)

    def why(self, robot: str) -> str | None:
        """Return what speaks for a robot being lost, None where it is not."""
        scans = self._failed.get(robot, [])
        if len(scans) < LOST_AFTER:
            return None
        failed, known = sum(look.failed for look in scans), sum(look.known for look in scans)
        return f'{failed} of {known} observations gated in a row'


def ignore(state: JointState, innovation: Innovation) -> None:
    """Doubt no landmark."""


def report(state: JointState, innovation: Innovation) -> None:
    """Keep for each landmark what speaks for it having been moved, until an observation passes."""
    scan_gate_statistics = innovation.scan_gate_statistics()
    rejected = _of_landmarks(gated.association for gated in innovation.rejected)
    far = _of_landmarks(g.association for g in innovation.rejected if g.d2 > FAR)
    passed = [
        (robot, landmark) for robot, landmark in _of_landmarks(innovation.used)
        if not scan_gate_statistics[robot.name].mostly_failed()]
    for robot, landmark in passed:
        landmark.last_accepted, landmark.moved_evidence = robot.stamp, None
    for robot, landmark in far:
        if _rather_the_landmark(robot, landmark, passed, rejected):
            landmark.moved_evidence = landmark.moved_evidence or MovedLandmarkEvidence()
            landmark.moved_evidence.add(robot.name, state.estimate(robot)[:2])


def _of_landmarks(seen: Iterable[Association]) -> list[tuple[Robot, Landmark]]:
    """Return who has seen which landmark."""
    return [(a.observer, a.observed) for a in seen if isinstance(a.observed, Landmark)]


def _rather_the_landmark(
    robot: Robot, landmark: Landmark, passed: Sequence[tuple[Robot, Landmark]],
    rejected: Sequence[tuple[Robot, Landmark]],
) -> bool:
    """
    Return whether the others in a scan tell that not the robot is wrong.

    Only those tell that were known when the landmark was last where the map has it: what the robot
    has started since may be as wrong as the robot.

    """
    right, wrong = (
        sum(by is robot and other is not landmark and other.created <= landmark.last_accepted
            for by, other in some)
        for some in (passed, rejected))
    return right + wrong >= MIN_OTHERS and right > wrong


def forget(state: JointState, innovation: Innovation) -> None:
    """Marginalise out what was moved, so that its next observation starts it at its new place."""
    report(state, innovation)
    for _, landmark in _of_landmarks(gated.association for gated in innovation.rejected):
        if landmark.was_moved() and landmark.key in state.landmarks:
            state.remove(landmark)


#: What a user may have done about landmarks that were moved.
MOVED_LANDMARKS: Mapping[str, Callable[[JointState, Innovation], None]] = {
    'report': report, 'forget': forget, 'ignore': ignore}
