# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The estimator: records in, steps out.

The live node, the replay of a bag, Monte Carlo runs and tests drive this one object by the same
two calls: `add` a record, `take` the finished steps.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence
import math
import sys

import numpy as np

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.data_association.landmark_manager import AssociatedScan, LandmarkManager
from fej_slam_ros.core.data_association.wrong_landmarks import review_landmarks
from fej_slam_ros.core.ekf.filter import Innovation, NO_INNOVATION
from fej_slam_ros.core.ekf.gating import Association, GatedObservation
from fej_slam_ros.core.ekf.linearization import LINEARIZATIONS
from fej_slam_ros.core.ekf.pose_inflation import inflate_poses
from fej_slam_ros.core.ekf.relative_pose import relative_pose
from fej_slam_ros.core.ekf.state import Landmark, Robot
from fej_slam_ros.core.ekf.state_hash import state_hash
from fej_slam_ros.core.estimates import (
    FrameMap, LandmarkEstimate, PoseEstimate, RelativePose, StepResult)
from fej_slam_ros.core.frame_groups import FrameGroup, FrameGroups
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.innovation_monitor import InnovationMonitor
from fej_slam_ros.core.new_landmarks import (
    MAX_NEW_WITHOUT_ID, room_for_landmarks, start_landmarks)
from fej_slam_ros.core.ordering.team_input import TeamInput
from fej_slam_ros.core.pose_evaluation import PoseEvaluation
from fej_slam_ros.core.quarantine import Quarantine
from fej_slam_ros.core.records import (
    AnyScan, LandmarkKey, NO_ID, PriorMap, Scan, Step, TruePose)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import check_values, RobotSettings, Settings
from fej_slam_ros.core.team_joiner import TeamJoiner
from fej_slam_ros.errors import UserError


class BrokenEstimateError(UserError):
    """A step exceeds the range or precision of floating-point numbers."""

    def __init__(self, stamp: int, cause: str) -> None:
        super().__init__(
            f'the estimate broke down at {stamp} ns ({cause}): look for covariances of the input'
            ' that are far too small or too large, and for odometry stamps that jump')


class Estimator(TeamInput[StepResult]):
    """
    Joint estimation of a team of robots and their map.

    Parameters
    ----------
    settings : parameters of the estimation, with the robots to begin with; an impossible value is
        a UsageError
    prior : landmarks known in ``map`` beforehand, if any
    innovations : statistics of innovations, to which those of this estimator are added

    Attributes
    ----------
    settings : parameters of the estimation at present
    robots : settings of each robot by name, in the order of processing
    needs_ids : whether the filter requires observations with IDs
    groups : the frame of each robot and its filter; `groups.not_in_map` has the reasons
    landmark_manager : landmarks observed without IDs
    innovations : NIS, likelihood and lost robots
    statistics : counts of used and rejected input
    sequencer : the waiting input
    steps : number of steps of each robot
    truth, evaluation : ground truth, if there is any, and the errors of the poses in ``map``

    """

    settings: Settings

    def __init__(
        self, settings: Settings, prior: PriorMap | None = None,
        innovations: InnovationMonitor | None = None,
    ) -> None:
        check_values(settings)
        super().__init__(settings)
        # Ground truth lists landmarks by ID.
        self.needs_ids = LINEARIZATIONS[settings.filter].needs_truth
        self.evaluation = PoseEvaluation(self.truth)
        self.groups = FrameGroups(settings, self.truth, prior)
        lowest_id = NO_ID if prior is None else min([NO_ID, *prior.ids])
        self.landmark_manager = LandmarkManager(lowest_id)
        self.innovations = innovations or InnovationMonitor()
        self._quarantine = Quarantine(self.groups, self.statistics, self.innovations.lost_robots)
        self._joiner = TeamJoiner(
            settings, self.groups, self.landmark_manager, self.statistics, self._pose_priors,
            self._quarantine)
        self.change_team(settings.robots)

    def change_team(
        self, robots: Sequence[RobotSettings], settings: Settings | None = None
    ) -> None:
        """
        Change the team: robots join and leave, and settings change from the next step on.

        A robot that leaves is marginalised out of the joint state; its landmarks stay. A robot
        that comes back starts at an unknown pose.

        Parameters
        ----------
        robots : robots of the team from now on, in the order of processing; their noise may differ
            from before
        settings : settings from now on, of which only changeable parameters may differ from
            before; None if they do not change

        """
        if settings is not None:
            self._change_settings(settings)
        super().change_team(robots)
        before, self.groups.robots = self.groups.robots, self.robots
        for name in before:
            if name not in self.robots:
                self.groups.leave(name)
                self.innovations.lost_robots.reset(name)
        for name in self.robots:
            if name not in before:
                self.innovations.nis.setdefault(name, NisMonitor())
                self.groups.not_in_map[name] = 'it sent no usable odometry'

    def pose(self, robot: str) -> PoseEstimate:
        """Return the pose of a robot after its last step; raise a KeyError before its first."""
        group = self.groups.of(robot)
        variable = group.robots[robot]
        return PoseEstimate(
            robot, variable.stamp, group.frame, group.state.pose(variable),
            group.state.marginal([variable]))

    def landmarks(self) -> tuple[LandmarkEstimate, ...]:
        """Return the confirmed landmarks in ``map``, ordered by ID."""
        return tuple(self.groups.team.map())

    def maps(self) -> list[FrameMap]:
        """Return the maps of all frames, ``map`` first."""
        return [group.map() for group in self.groups]

    def joint_covariance(self) -> Array:
        """Return the covariance (3 N, 3 N) of the robots in ``map``, as in `StepResult.joined`."""
        return self.groups.team.state.marginal(self._joined())

    def relative_pose(self, observer: str, observed: str) -> RelativePose | None:
        """Return the pose of a robot in the base frame of another if both are in ``map``."""
        team = self.groups.team
        if not {observer, observed} <= team.robots.keys():
            return None
        return relative_pose(team.state, team.filter.linearization, observer, observed)

    def state_hash(self) -> str:
        """Return SHA-256 over all estimates; equal for equal input on one machine."""
        return state_hash(
            {group.frame: group.state for group in self.groups}, list(self.robots))

    def _add_true_pose(self, record: TruePose) -> RejectionReason | None:
        """Add ground truth, for which odometry may not come."""
        reason = super()._add_true_pose(record)
        if reason is None:
            for stamp in self.truth.take_surplus(record.robot):
                self.statistics.reject(
                    Rejection(record.robot, stamp, RejectionReason.AFTER_ODOMETRY))
        return reason

    def _change_settings(self, settings: Settings) -> None:
        self.settings = settings
        self.groups.change_settings(settings)
        self._joiner.change_settings(settings)
        self.sequencer.change_limits(settings)

    def _results(self, steps: Iterator[Step]) -> Iterator[StepResult]:
        return map(self._checked_step, steps)

    def _checked_step(self, step: Step) -> StepResult:
        try:
            result = self._step(step)
        except (ArithmeticError, np.linalg.LinAlgError) as error:
            raise BrokenEstimateError(step.stamp, str(error)) from error
        if not all(math.isfinite(sum(map(sum, pose.P.tolist()))) for pose in result.poses):
            raise BrokenEstimateError(step.stamp, 'covariance not finite')
        return result

    def _step(self, step: Step) -> StepResult:
        """Process one stamp: predict, start landmarks, update, join."""
        for name in step.arrivals:
            self.groups.begin(self.robots[name], step.stamp)
        for motion in step.motions:
            group = self.groups.of(motion.robot)
            self._pose_priors.advance(motion, group.robots[motion.robot].stamp)
            if not self._quarantine.restart_after(motion):
                group.filter.predict(motion)
        for name in step.odometry:
            # Before the scans of the step, which the former pose would contradict.
            if self._joiner.relocate(name, step.stamp):
                self.innovations.lost_robots.reset(name)
        # Odometry alone relates nothing.
        associated = self._use_scans(step) if step.scans or step.robot_scans else ()
        for name in step.odometry:
            self._joiner.apply_pose_priors(name, step.stamp)
        return self._result(step, associated)

    def _use_scans(self, step: Step) -> list[Scan]:
        """Start landmarks, update and join; return the associated observations without IDs."""
        self._quarantine.restart_turned(step, self.settings.join_min_landmarks)
        used_up = self._joiner.initialize(step) if self._joiner.is_step_0(step) else ()
        lost_robots = self.innovations.lost_robots
        for robot_scan in step.robot_scans:
            self._joiner.add_rendezvous_points(robot_scan, lost_robots.is_suspected)
        associated = [
            scan for group in self.groups
            for scan in self._observe(group, step, used_up if group is self.groups.team else ())]
        scans: list[AnyScan] = [*step.scans, *step.robot_scans]
        # All count as used; a rejection of a single one subtracts it again.
        for scan in scans:
            self.statistics.observations_used[scan.robot] += len(scan.observations)
        self._quarantine.restart_lost(step, self.settings.join_min_landmarks)
        self._joiner.join(lost_robots.on_probation())
        lost_robots.mark_found(self.groups.team.robots)
        self.truth.keep_rendezvous_points(
            {key for state in self.groups.states() for key in state.rendezvous_points})
        return associated

    def _observe(
        self, group: FrameGroup, step: Step, used_up: Collection[LandmarkKey]
    ) -> list[Scan]:
        """
        Update a group by the scans of its robots; return the associated observations without IDs.

        Step 0 has `used_up` the observations of some landmarks.

        """
        scans, associations = self._associate(group, step.scans, used_up)
        associations += self._quarantine.robot_associations(group, step)
        innovation = group.filter.update(associations)
        if innovation is not NO_INNOVATION:
            self._account(group, step.stamp, innovation)
        for scan in scans:
            self.landmark_manager.update_tentative(group.filter, scan)
        return [scan.associated for scan in scans if scan.associated.observations]

    def _associate(
        self, group: FrameGroup, scans: Iterable[Scan], used_up: Collection[LandmarkKey]
    ) -> tuple[list[AssociatedScan], list[Association]]:
        """Return the scans of a group with IDs for all observations, and those for the update."""
        lost_robots = self.innovations.lost_robots
        associated, associations = [], []
        for scan in scans:
            if scan.robot in group.robots:
                known = self.landmark_manager.associate(
                    group.filter, scan, self.settings.match_probability)
                lost_robots.add_matches(scan.robot, known.statistics)
                known = self._quarantine.restrict_suspected(group, known)
                for observation in known.doubtful:
                    self.statistics.reject_observation(Rejection(
                        scan.robot, scan.stamp, RejectionReason.DOUBTFUL_MATCH, id=observation.id))
                with_ids = self._start_landmarks(group, known.with_ids)
                associations += with_ids if not used_up else [
                    a for a in with_ids
                    if isinstance(a.observed, Landmark) and a.observed.key not in used_up]
                associations += self._start_landmarks(
                    group, known.associated, MAX_NEW_WITHOUT_ID, RejectionReason.TOO_MANY_NEW)
                associated.append(known)
        return associated, associations

    def _start_landmarks(
        self, group: FrameGroup, scan: Scan, most: int = sys.maxsize,
        reason: RejectionReason = RejectionReason.MAP_FULL,
    ) -> list[Association]:
        """Start at most some new landmarks, and reject the others for a reason."""
        room = room_for_landmarks(
            group.state, self.groups.states(), self.settings.max_landmarks)
        if room < most:
            most, reason = room, RejectionReason.MAP_FULL
        return start_landmarks(group.filter, scan, most, reason, self.statistics)

    def _account(self, group: FrameGroup, stamp: int, innovation: Innovation) -> None:
        """Record the statistics, moved landmarks and rejected observations of an update."""
        scan_statistics = innovation.scan_gate_statistics()
        self.innovations.add(stamp, innovation, scan_statistics)
        inflate_poses(
            group.filter, innovation, scan_statistics, self.innovations.lost_robots.rejections,
            self.innovations.lost_robots.may_have_slipped)
        for started in review_landmarks(
                group.state, innovation, scan_statistics, stamp, self.settings.moved_landmarks):
            self.statistics.reject_observation(started)
        for inflated in innovation.inflated:
            self.statistics.observations_inflated[inflated.association.observer.name] += 1
        for gated in innovation.rejected:
            self.statistics.reject_observation(self._gated(gated, stamp))
        for association in innovation.interrupted:
            self.statistics.reject_observation(Rejection(
                association.observer.name, stamp, RejectionReason.INTERRUPTED,
                id=self._observed_id(association)))

    def _gated(self, gated: GatedObservation, stamp: int) -> Rejection:
        """Return the rejection of an observation that failed the gate."""
        (observer, observed, _), reason = gated.association, RejectionReason.GATED
        if gated.passed():
            reason = RejectionReason.LOST_ROBOT
        elif not isinstance(observed, Robot) and observed.was_moved():
            reason = RejectionReason.MOVED_LANDMARK
        return Rejection(
            observer.name, stamp, reason, id=self._observed_id(gated.association),
            d2=gated.d2, threshold=gated.threshold,
            observed=observed.name if isinstance(observed, Robot) else None)

    def _observed_id(self, association: Association) -> int:
        observed = association.observed
        return self.robots[observed.name].id if isinstance(observed, Robot) else observed.key[1]

    def _result(self, step: Step, associated: Sequence[Scan]) -> StepResult:
        poses = tuple(map(self.pose, step.odometry))
        for pose in poses:
            self.steps[pose.robot] += 1
            if pose.frame == MAP:
                self.evaluation.add(pose.robot, pose.stamp, pose.pose, pose.P)
            else:
                self.evaluation.pass_over(pose.robot, pose.stamp)
        joined = tuple((robot.name, robot.stamp) for robot in self._joined())
        return StepResult(step.stamp, poses, joined, step.odometry, associated)

    def _joined(self) -> list[Robot]:
        """Return the robots in ``map``, in the order of processing."""
        robots = self.groups.team.robots
        return [robots[name] for name in self.robots if name in robots]
