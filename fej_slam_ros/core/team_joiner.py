# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joining of frame groups: its conditions, and the handling of its result.

Groups join at step 0, by shared landmarks and rendezvous points, or by an initial pose that was
given for one of their robots. The joining of two frames is in :mod:`fej_slam_ros.core.joining`.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from fej_slam_ros.core.data_association.constellations import (
    count_without_id, MIN_MATCHES, renamed, shared_landmarks)
from fej_slam_ros.core.data_association.landmark_manager import LandmarkManager
from fej_slam_ros.core.data_association.wrong_landmarks import rejected_start
from fej_slam_ros.core.ekf.state import JointState, Landmark
from fej_slam_ros.core.frame_groups import FrameGroup, FrameGroups
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.initial_alignment import InitialAlignmentError, InitialScans
from fej_slam_ros.core.joining.initialization import initialize, START_COVARIANCES
from fej_slam_ros.core.joining.map_joining import MapJoiner
from fej_slam_ros.core.joining.rendezvous_points import add_rendezvous_point, marginalize
from fej_slam_ros.core.new_landmarks import room_for_landmarks
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.pose_priors import PosePriors
from fej_slam_ros.core.pieces import EndedError
from fej_slam_ros.core.point_consensus import OUTLIER_D2
from fej_slam_ros.core.quarantine import Quarantine
from fej_slam_ros.core.records import (
    is_too_uncertain, LandmarkKey, MAX_LINEAR_HEADING_SIGMA, NO_ID, NS, RendezvousKey, RobotScan,
    Step)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.core.settings import Settings


#: Time between two comparisons of the landmarks without ID of two groups [ns]. It is also that
#: between two attempts to join groups that share VARIABLES_OF_PERIOD landmarks and rendezvous
#: points: the cost of an attempt grows with the cube of their number.
COMPARISON_PERIOD = NS
VARIABLES_OF_PERIOD = 200
#: Number of matches of landmarks without ID of which one may be left out because it does not fit.
MATCHES_OF_MISFIT = 3
#: Longest time between two attempts [ns], and number of failures in a row up to which it grows.
MAX_PAUSE, MAX_FAILURES = 60 * NS, 10


class TeamJoiner:
    """Joins the frame groups of a team, and merges the duplicate landmarks of joined maps."""

    def __init__(
        self, settings: Settings, groups: FrameGroups, landmark_manager: LandmarkManager,
        statistics: InputStatistics, pose_priors: PosePriors,
        quarantine: Quarantine,
    ) -> None:
        self._settings = settings
        self._groups = groups
        self._landmark_manager = landmark_manager
        self._statistics = statistics
        self._pose_priors = pose_priors
        self._quarantine = quarantine
        self._joiner = _map_joiner(settings)
        # By the frames of two groups: when their landmarks without ID were compared [ns], and why
        # they do not join.
        self._compared: dict[tuple[str, str], tuple[int, str]] = {}
        # By the frames of two groups: when joining them is attempted again [ns], how many
        # landmarks and points they shared when it failed, how often it did in a row, and why.
        self._postponed: dict[tuple[str, str], tuple[int, int, int, str]] = {}

    def change_settings(self, settings: Settings) -> None:
        """Use other conditions of joining from now on."""
        self._settings, self._joiner = settings, _map_joiner(settings)
        self._postponed.clear()

    def is_step_0(self, step: Step) -> bool:
        """Return whether the anchor observes its first landmark in a step."""
        return not self._groups.is_initialized and any(
            scan.robot == self._settings.anchor and scan.observations for scan in step.scans)

    def initialize(self, step: Step) -> Collection[LandmarkKey]:
        """Run step 0; return the landmarks of ``map`` whose observations it has used up."""
        team = self._groups.team
        self._groups.is_initialized = True
        scans: InitialScans = {
            scan.robot: [
                (key, s) for key, s in zip(team.filter.keys_of(scan), scan.observations)
                if s.id != NO_ID]
            for scan in step.scans}
        used: Collection[LandmarkKey] = ()
        try:
            state = initialize(
                team.state, self._settings.anchor, scans, step.stamp, team.filter.linearization,
                START_COVARIANCES[self._settings.start_covariance],
                room_for_landmarks(
                    team.state, self._groups.states(), self._settings.max_landmarks),
                max(MAX_LINEAR_HEADING_SIGMA, self._settings.join_heading_sigma))
        except (InitialAlignmentError, EndedError):
            state = None
        if state is not None:
            others = [group.state for group in self._groups.others]
            marginalize(team.state.rendezvous_points, others)
            team.filter.state, used = state, {*state.landmarks}
        self._restart_uncertain(step.stamp)
        # Groups of robots that step 0 has placed in ``map``.
        for group in [*self._groups.others]:
            if group.owner in team.robots.keys() & group.robots.keys():
                self._join_via_robot(group, group.owner)
        return used

    def _restart_uncertain(self, stamp: int) -> None:
        """Restart robots at start poses that step 0 leaves too uncertain to linearise."""
        team = self._groups.team
        anchor = team.robots.get(self._settings.anchor)
        # The error of the anchor turns the whole map.
        P_map = np.zeros((3, 3)) if anchor is None else team.state.marginal([anchor])
        for name, robot in [*team.robots.items()]:
            has_start = self._groups.robots[name].start_pose is not None
            if has_start and is_too_uncertain(team.state.marginal([robot]) - P_map):
                self._quarantine.restart(name, stamp, 'its pose is too uncertain to linearise')

    def add_rendezvous_points(
        self, scan: RobotScan, is_suspected: Callable[[str], bool]
    ) -> None:
        """Add rendezvous points for observations across frames, unless a robot may be lost."""
        observer = self._groups.of(scan.robot)
        for observation in scan.observations:
            observed = self._groups.of(observation.observed)
            key = RendezvousKey(scan.robot, observation.observed, scan.stamp)
            if observed is observer:
                continue
            if is_suspected(scan.robot) or is_suspected(observation.observed):
                self._reject(key, RejectionReason.LOST_ROBOT)
            elif not add_rendezvous_point(observer.filter, observed.filter, key, observation):
                self._reject(key, RejectionReason.NOT_JOINED)

    def join(self, on_probation: Mapping[str, str]) -> None:
        """
        Join the groups that share enough: with the team first, then with each other.

        Groups with a robot that is on probation, for the given reason, wait.

        """
        for name, reason in on_probation.items():
            if name in self._groups.not_in_map:
                self._groups.not_in_map[name] = reason
        for group in self._without_robots(on_probation):
            self._join_to_team(group)
        if self._groups.is_initialized:
            for group, other in combinations(self._without_robots(on_probation), 2):
                if group in self._groups.others and other in self._groups.others:
                    self._join_groups(group, other)

    def relocate(self, robot: str, stamp: int) -> bool:
        """
        Apply the poses of a robot in ``map`` that are due at one of its steps; return if any is.

        The robot restarts at the pose, or in its own frame if that is too uncertain to linearise.

        """
        if robot not in self._groups.team.robots:
            return False
        due = self._pose_priors.take(robot, stamp)
        self._statistics.pose_priors_used[robot] += len(due)
        for prior in due:
            if is_too_uncertain(prior.P):
                self._quarantine.restart(robot, stamp, 'its pose is not known')
            else:
                self._groups.place(robot, stamp, prior.pose, prior.P)
        return bool(due)

    def apply_pose_priors(self, robot: str, stamp: int) -> None:
        """Apply the initial poses of a robot outside ``map`` that are due at one of its steps."""
        for prior in self._pose_priors.take(robot, stamp):
            group = self._groups.of(robot)
            if group is self._groups.team:
                reason = RejectionReason.ALREADY_LOCATED
            elif not is_too_uncertain(prior.P) and self._joiner.apply_pose_prior(
                self._groups.team.filter, group.filter, robot, prior.pose, prior.P
            ):
                self._statistics.pose_priors_used[robot] += 1
                self._join_via_robot(group, robot)
                continue
            else:
                reason = RejectionReason.DOES_NOT_FIT
            self._statistics.reject(Rejection(robot, prior.stamp, reason))

    def _without_robots(self, robots: Collection[str]) -> list[FrameGroup]:
        """Return the groups beside the team that have none of some robots."""
        return [g for g in self._groups.others if g.robots.keys().isdisjoint(robots)]

    def _join_to_team(self, group: FrameGroup) -> None:
        """Join a group to the team if they share enough, or note the reason if they do not."""
        team = self._groups.team
        has_rendezvous = (
            team.state.rendezvous_points.keys() & group.state.rendezvous_points.keys())
        # Before step 0 only rendezvous points join groups; step 0 uses the shared landmarks. An
        # empty ``map``, whose anchor has no valid start, has nothing to share.
        if team.state.covariance.dimension and (self._groups.is_initialized or has_rendezvous):
            failure = self._join_groups(team, group)
            if failure is not None:
                self._groups.not_in_map.update(dict.fromkeys(group.robots, failure.reason))

    def _join_groups(self, group: FrameGroup, other: FrameGroup) -> JoinFailure | None:
        """Join another group to a group; on failure, remove the outliers."""
        if not group.robots and not other.robots:
            return JoinFailure('neither map has a robot, with which errors turn')
        failure = self._join_by_shared(group, other)
        if failure is not None and not failure.has_outliers():
            failure = self._join_without_ids(group, other, failure)
        if failure is None:
            self._groups.merge(group, other)
            self._landmark_manager.merge(group.filter, other.owner)
        elif failure.outlier is not None:
            marginalize([failure.outlier], self._groups.states())
            self._reject(failure.outlier, RejectionReason.GATED, failure.d2, OUTLIER_D2)
        else:
            for state in (group.state, other.state):
                self._remove_outlying(
                    state, [state.landmarks[key] for key in failure.outlying_landmarks])
        return failure

    def _join_without_ids(
        self, group: FrameGroup, other: FrameGroup, failure: JoinFailure
    ) -> JoinFailure | None:
        """Join another group by landmarks without ID, where shared ones have failed to do so."""
        without_id = [count_without_id(each.state) for each in (group, other)]
        if all(without_id):
            return self._join_by_constellation(group, other)
        if any(without_id):
            return JoinFailure(
                f'{failure.reason}; {counted(sum(without_id), "landmark")} without ID, compared'
                ' with others without ID only')
        return failure

    def _join_by_shared(self, group: FrameGroup, other: FrameGroup) -> JoinFailure | None:
        """Join another group to a group, but not again soon if that is expensive."""
        frames, newest = (group.frame, other.frame), _newest_stamp(group, other)
        shared = sum(len(mine.keys() & theirs.keys()) for mine, theirs in (
            (group.state.landmarks, other.state.landmarks),
            (group.state.rendezvous_points, other.state.rendezvous_points)))
        due, shared_then, failures, reason = self._postponed.get(frames, (newest, 0, 0, ''))
        # A robot that has restarted shares fewer.
        if newest < due and shared >= shared_then:
            return JoinFailure(reason)
        failure = self._joiner.join(group.filter, other.filter)
        self._postponed.pop(frames, None)
        if failure is not None and not failure.has_outliers():
            failures = min(failures + 1, MAX_FAILURES)
            pause = int(COMPARISON_PERIOD * failures * (shared / VARIABLES_OF_PERIOD) ** 3)
            self._postponed[frames] = (
                newest + min(pause, MAX_PAUSE), shared, failures, failure.reason)
        return failure

    def _remove_outlying(self, state: JointState, landmarks: Sequence[Landmark]) -> None:
        """Remove landmarks; single observations that have started them are rejected."""
        state.remove_all(landmarks)
        for landmark in (f for f in landmarks if not f.is_reobserved):
            self._statistics.reject_observation(rejected_start(landmark, RejectionReason.GATED))

    def _join_by_constellation(self, group: FrameGroup, other: FrameGroup) -> JoinFailure | None:
        """Join another group to a group that has the same landmarks without ID."""
        frames = group.frame, other.frame
        newest = _newest_stamp(group, other)
        compared_at, reason = self._compared.get(frames, (-COMPARISON_PERIOD, ''))
        if 0 <= newest - compared_at < COMPARISON_PERIOD:
            return JoinFailure(reason)
        found = shared_landmarks(group.state, other.state)
        failure = (
            found if isinstance(found, JoinFailure)
            else self._join_by_matches(group, other, found))
        if failure is None:
            self._compared.pop(frames, None)
        else:
            self._compared[frames] = newest, failure.reason
        return failure

    def _join_by_matches(
        self, group: FrameGroup, other: FrameGroup, found: Mapping[LandmarkKey, LandmarkKey]
    ) -> JoinFailure | None:
        """Join another group whose landmarks, by key, were found in a group as others."""
        before, same = other.state, found
        other.filter.state = renamed(before, same)
        # A landmark may look different from elsewhere, or be the neighbour of the right one.
        most = min(len(found) // MATCHES_OF_MISFIT, len(found) - MIN_MATCHES)
        misfits = self._joiner.misfits(group.filter, other.filter, most)
        if misfits:
            same = {old: new for old, new in found.items() if new not in misfits}
            other.filter.state = renamed(before, same)
        failure = self._joiner.join(group.filter, other.filter)
        if failure is not None:
            other.filter.state = before
            # Matches of landmarks without ID may be wrong, which is no reason to remove any.
            return replace(failure, outlying_landmarks=())
        self._landmark_manager.replace_ids({old[1]: new[1] for old, new in same.items()})
        return None

    def _join_via_robot(self, group: FrameGroup, robot: str) -> None:
        """Join a group to the team, whose state already contains one of its robots."""
        if self._joiner.join_via_robot(self._groups.team.filter, group.filter, robot):
            self._groups.merge(self._groups.team, group)
            self._landmark_manager.merge(self._groups.team.filter, robot)
        else:
            self._groups.mark_joined([robot])
            self._groups.rename(group)

    def _reject(
        self, key: RendezvousKey, reason: RejectionReason, d2: float | None = None,
        threshold: float | None = None,
    ) -> None:
        """Reject a robot-to-robot observation that was counted as used."""
        self._statistics.reject_observation(Rejection(
            key.observer, key.stamp, reason, id=self._groups.robots[key.observed].id, d2=d2,
            threshold=threshold, observed=key.observed))


def _newest_stamp(*groups: FrameGroup) -> int:
    return max((robot.stamp for group in groups for robot in group.robots.values()), default=0)


def _map_joiner(settings: Settings) -> MapJoiner:
    return MapJoiner(
        settings.join_min_landmarks, settings.join_probability, settings.join_heading_sigma)
