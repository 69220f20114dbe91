# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Landmarks that are wrong: started by a lost robot or under a misread ID, or moved since.

A landmark that a lost robot has started is not trusted before a scan that other trusted landmarks
confirm observes it. One that fails the gate again and again, among others that pass, was moved.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence

from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, StatisticsByRobot
from fej_slam_ros.core.ekf.landmark_evidence import MovedLandmarkEvidence
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.rejections import Rejection, RejectionReason

#: Minimum number of other landmarks in a scan by which the robot's pose is checked.
MIN_OTHERS = 2


def review_landmarks(
    state: JointState, innovation: Innovation, statistics: StatisticsByRobot, stamp: int,
    moved_landmarks: str,
) -> list[Rejection]:
    """
    Trust, distrust and remove landmarks after an update at a stamp [ns].

    Returns the observations that had started the removed ones as rejected, but for landmarks that
    were moved since. `moved_landmarks` is the parameter.

    """
    note_accepted(innovation, statistics)
    rejections = [
        *remove_started(state, statistics, stamp),
        *remove_contradicted(state, innovation, statistics)]
    MOVED_LANDMARKS[moved_landmarks](state, innovation, statistics)
    return rejections


def rejected_start(landmark: Landmark, reason: RejectionReason) -> Rejection:
    """Return the rejection of the observation that started a landmark."""
    return Rejection(landmark.owner, landmark.created, reason, id=landmark.key[1])


def note_accepted(innovation: Innovation, statistics: StatisticsByRobot) -> None:
    """
    Note the accepted observations on their landmarks, whatever `moved_landmarks` is.

    Those by robots that are not suspected end the evidence that a landmark was moved; landmarks in
    scans that confirm the robot's pose are trusted.

    """
    for a in innovation.used:
        if isinstance(a.observed, Landmark):
            scan = statistics[a.observer.name]
            a.observed.is_reobserved = True
            a.observed.is_trusted |= scan.confirms_pose()
            if not scan.mostly_failed():
                a.observed.last_accepted, a.observed.moved_evidence = a.observer.stamp, None


def remove_started(
    state: JointState, statistics: StatisticsByRobot, stamp: int
) -> list[Rejection]:
    """
    Remove landmarks that wrong scans started; return the observations of them as rejected.

    A robot that is not where it is estimated starts landmarks that fit its pose and nothing else.
    They are not trusted, for they were never observed together with landmarks that are.

    """
    gated = {robot for robot, scan in statistics.items() if scan.mostly_gated()}
    started = [
        landmark for landmark in state.landmarks.values()
        if landmark.owner in gated and landmark.created == stamp] if gated else []
    state.remove_all(started)
    return [rejected_start(landmark, RejectionReason.LOST_ROBOT) for landmark in started]


def remove_contradicted(
    state: JointState, innovation: Innovation, statistics: StatisticsByRobot
) -> list[Rejection]:
    """
    Remove landmarks whose second observation contradicts the first; return that as rejected.

    One of the two is wrong, such as a misread tag. The next observation starts the landmark again.

    """
    contradicted: dict[LandmarkKey, Landmark] = {}
    for gated in innovation.rejected:
        observer, observed, _ = gated.association
        if (isinstance(observed, Landmark) and not observed.is_reobserved
                and gated.contradicts() and not statistics[observer.name].mostly_failed()
                and observed.key in state.landmarks):
            contradicted[observed.key] = observed
    state.remove_all([*contradicted.values()])
    return [
        rejected_start(landmark, RejectionReason.GATED) for landmark in contradicted.values()]


def remove_untrusted(state: JointState, robot: str) -> None:
    """Remove the landmarks that a lost robot has started and nothing confirms."""
    state.remove_all([
        landmark for landmark in state.landmarks.values()
        if landmark.owner == robot and not landmark.is_trusted])


def ignore_moved(
    state: JointState, innovation: Innovation, statistics: StatisticsByRobot
) -> None:
    """Do not look for moved landmarks."""


def report_moved(
    state: JointState, innovation: Innovation, statistics: StatisticsByRobot
) -> None:
    """Collect evidence for each landmark that fails the gate among others that pass."""
    if not innovation.rejected:
        return
    passed = _landmark_pairs(
        a for a in innovation.used if not statistics[a.observer.name].mostly_failed())
    rejected = _landmark_pairs(gated.association for gated in innovation.rejected)
    contradicting = _landmark_pairs(
        gated.association for gated in innovation.rejected if gated.contradicts())
    for robot, landmark in contradicting:
        if _pose_is_confirmed(robot, landmark, passed, rejected):
            landmark.moved_evidence = landmark.moved_evidence or MovedLandmarkEvidence()
            landmark.moved_evidence.add(robot.name, state.pose(robot)[:2])


def forget_moved(
    state: JointState, innovation: Innovation, statistics: StatisticsByRobot
) -> None:
    """Remove moved landmarks, so that the next observation starts them at their new position."""
    report_moved(state, innovation, statistics)
    moved = {
        landmark.key: landmark
        for _, landmark in _landmark_pairs(gated.association for gated in innovation.rejected)
        if landmark.was_moved() and landmark.key in state.landmarks}
    state.remove_all([*moved.values()])


#: The values of parameter `moved_landmarks`.
MOVED_LANDMARKS: Mapping[str, Callable[[JointState, Innovation, StatisticsByRobot], None]] = {
    'report': report_moved, 'forget': forget_moved, 'ignore': ignore_moved}


def _landmark_pairs(associations: Iterable[Association]) -> list[tuple[Robot, Landmark]]:
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
