# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Quarantine: a robot that may be lost changes nothing that it shares with others.

While most of its latest scan contradicts the map, it starts no landmarks and takes part in no
robot-to-robot observation. If that lasts, it restarts in its own frame, where it is on probation.
"""

from collections.abc import Iterable
from dataclasses import replace
import math

from fej_slam_ros.core.data_association.constellations import can_be_found
from fej_slam_ros.core.data_association.failure_detection import LostRobotDetector
from fej_slam_ros.core.data_association.landmark_manager import AssociatedScan
from fej_slam_ros.core.data_association.wrong_landmarks import remove_untrusted
from fej_slam_ros.core.ekf.gating import Association, ScanGateStatistics
from fej_slam_ros.core.ekf.state import JointState, Variables
from fej_slam_ros.core.frame_groups import FrameGroup, FrameGroups
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.records import is_too_uncertain, Motion, Step
from fej_slam_ros.core.rejections import Rejection, RejectionReason


class Quarantine:
    """Restarts robots, and restricts the input of robots that may be lost."""

    def __init__(
        self, groups: FrameGroups, statistics: InputStatistics, lost_robots: LostRobotDetector
    ) -> None:
        self._groups = groups
        self._statistics = statistics
        self._lost_robots = lost_robots

    def restart_after(self, motion: Motion) -> bool:
        """Restart a robot in a frame of its own if its motion is unknown; return whether it is."""
        if motion.impossible:
            self.restart(motion.robot, motion.stamp, motion.impossible)
            self._lost_robots.reset(motion.robot)
        elif is_too_uncertain(motion.Q):
            self.restart(
                motion.robot, motion.stamp,
                'the gap in its odometry is too long, or its twist.covariance too large, for a'
                ' prediction')
        else:
            return False
        return True

    def restart_turned(self, step: Step, min_landmarks: int) -> None:
        """
        Restart robots whose heading is too uncertain to be linearised, if they can join again.

        This happens after a long turn by odometry alone, when known landmarks or robots of the
        frame are observed again, whose directions are as uncertain: a join may have determined
        them in the meantime. The last robot of a frame stays in it: without a robot, a map would
        rarely be joined.

        """
        for scan in step.scans:
            group = self._groups.of(scan.robot)
            reason = _why_turned(group, scan.robot, min_landmarks)
            if reason:
                landmarks = group.state.landmarks
                self._restart_if_uncertain(scan.robot, step.stamp, reason, [
                    landmarks[key] for key in group.filter.keys_of(scan) if key in landmarks])
        for robot_scan in step.robot_scans:
            for observation in robot_scan.observations:
                pair = robot_scan.robot, observation.observed
                for robot, other in (pair, pair[::-1]):
                    group = self._groups.of(robot)
                    reason = _why_turned(group, robot, min_landmarks)
                    if reason and other in group.robots:
                        self._restart_if_uncertain(
                            robot, step.stamp, reason, [group.robots[other]])

    def _restart_if_uncertain(self, robot: str, stamp: int, reason: str, seen: Variables) -> None:
        """Restart a robot if directions of what it observes are too uncertain."""
        filter_ = self._groups.of(robot).filter
        sigmas = filter_.direction_sigmas(filter_.state.robots[robot], seen)
        if (sigmas > filter_.linearization.max_turn_sigma).any():
            self.restart(robot, stamp, reason)

    def restart_lost(self, step: Step, min_landmarks: int) -> None:
        """Restart robots that the scans up to a step, its own included, show to be lost."""
        observers = [scan.robot for scan in step.scans]
        observed = [s.observed for scan in step.robot_scans for s in scan.observations]
        self._restart_failing(observers, step.stamp, min_landmarks)
        self._restart_unjoined(observers, step.stamp, min_landmarks)
        self._restart_ambiguous(observers, step.stamp)
        self._restart_contradicted(observed, step.stamp)
        self._restart_rejected([*observers, *observed], step.stamp, min_landmarks)

    def restrict_suspected(self, group: FrameGroup, scan: AssociatedScan) -> AssociatedScan:
        """
        Return a scan, restricted to known landmarks if its robot may be lost.

        A scan with too few of them to check the pose keeps none. Observations that are left out
        are rejected.

        """
        robot, parts = scan.with_ids.robot, (scan.with_ids, scan.associated)
        if not self._lost_robots.is_suspected(robot):
            return scan
        keys = [key for part in parts for key in group.filter.keys_of(part)]
        if not keys:
            return scan
        landmarks = group.state.landmarks
        known = {key for key in keys if key in landmarks}
        statistics = ScanGateStatistics()
        for key in known:
            statistics.add(robot, landmarks[key], failed=False, gated=False)
        if not statistics.can_clear():
            known = set()
            self._lost_robots.add_inconclusive(robot)
        for key in keys:
            if key not in known:
                self._reject(robot, scan.with_ids.stamp, key[1])
        with_ids, associated = (
            replace(part, observations=tuple(
                s for s, key in zip(part.observations, group.filter.keys_of(part))
                if key in known)) for part in parts)
        return replace(scan, with_ids=with_ids, associated=associated)

    def robot_associations(self, group: FrameGroup, step: Step) -> list[Association]:
        """Return the observations between robots of a group; reject them if one may be lost."""
        kept: list[Association] = []
        for association in group.filter.associate_robots(step.robot_scans):
            observer, observed = association.observer.name, association.observed.name
            if any(map(self._lost_robots.is_suspected, (observer, observed))):
                self._reject(observer, step.stamp, self._groups.robots[observed].id, observed)
            else:
                kept.append(association)
        return kept

    def _restart_failing(self, robots: Iterable[str], stamp: int, min_landmarks: int) -> None:
        """Restart robots whose scans mostly failed, if they can join again by landmarks."""
        for robot in filter(self._lost_robots.must_restart, robots):
            state = self._groups.of(robot).state
            remove_untrusted(state, robot)
            if _count_with_ids(state) >= min_landmarks or can_be_found(state):
                self._lost_robots.mark_lost(robot)
                self.restart(robot, stamp, f'likely lost, {self._lost_robots.reason(robot)}')

    def _restart_unjoined(self, robots: Iterable[str], stamp: int, min_landmarks: int) -> None:
        """Restart lost robots whose own maps share enough landmarks to join, and do not fit."""
        team = self._groups.team
        for robot in filter(self._lost_robots.remains_unjoined, robots):
            group = self._groups.of(robot)
            shared = team.state.landmarks.keys() & group.state.landmarks.keys()
            # A pose may just have placed it in the team.
            if group is not team and len(shared) >= min_landmarks:
                self._lost_robots.mark_lost(robot)
                self.restart(
                    robot, stamp, f'its own map has {len(shared)} landmarks of the team and does'
                    ' not fit')

    def _restart_contradicted(self, robots: Iterable[str], stamp: int) -> None:
        """Restart robots that others, whose landmarks confirm their poses, observe elsewhere."""
        for robot in robots:
            observations = self._lost_robots.by_others.count(robot)
            if observations:
                remove_untrusted(self._groups.of(robot).state, robot)
                self.restart(
                    robot, stamp,
                    f'{observations} observations of it in a row contradict its pose')

    def _restart_rejected(
        self, robots: Iterable[str], stamp: int, min_landmarks: int
    ) -> None:
        """Restart robots that a row of observations shows to be turned, if they can join again."""
        for robot in robots:
            count, group = self._lost_robots.rejections.count(robot), self._groups.of(robot)
            if count and _can_leave(group, min_landmarks):
                remove_untrusted(group.state, robot)
                self.restart(
                    robot, stamp, f'{count} observations by and of it in a row failed the gate')

    def _restart_ambiguous(self, robots: Iterable[str], stamp: int) -> None:
        """
        Restart robots whose observations without ID fit several places, if they can join again.

        None of these observations can be used in this frame. In a frame of its own a robot can map
        with them, and that map is compared as a whole.

        """
        for robot in robots:
            observations = self._lost_robots.ambiguous(robot)
            if observations and can_be_found(self._groups.of(robot).state):
                self.restart(
                    robot, stamp, f'{observations} observations in a row fit several landmarks')

    def restart(self, robot: str, stamp: int, reason: str) -> None:
        """Restart a robot in a frame of its own, without what concerns its former pose."""
        self._lost_robots.begin_frame(robot)
        self._statistics.count_restart(robot, reason)
        self._groups.restart(robot, stamp, reason)

    def _reject(self, robot: str, stamp: int, id_: int, observed: str | None = None) -> None:
        self._statistics.reject_observation(
            Rejection(robot, stamp, RejectionReason.LOST_ROBOT, id=id_, observed=observed))


def _why_turned(group: FrameGroup, robot: str, min_landmarks: int) -> str:
    """Return why a robot restarts for its uncertain heading, '' if it does not."""
    variance = group.robots[robot].turn_variance
    is_uncertain = variance > group.filter.linearization.max_turn_sigma ** 2
    if not is_uncertain or not _can_leave(group, min_landmarks):
        return ''
    return (
        f'its heading has become uncertain by {math.sqrt(variance):.2f} rad since it was last'
        ' corrected')


def _can_leave(group: FrameGroup, min_landmarks: int) -> bool:
    """Return whether a frame keeps a robot without this one, and this one can join it again."""
    return len(group.robots) > 1 and _count_with_ids(group.state) >= min_landmarks


def _count_with_ids(state: JointState) -> int:
    """Return the number of landmarks that are observed with IDs."""
    return sum(id_ >= 0 for _, id_ in state.landmarks)
