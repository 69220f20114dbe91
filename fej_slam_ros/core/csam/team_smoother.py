# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Smoother of a team: takes records, yields poses, returns smoothing tasks, adopts solutions.

The live node, `smooth` and tests use it in the same way as the estimator. They also solve the
tasks: this takes long, and may run in another process while records arrive.
"""

from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import permutations

import numpy as np

from fej_slam_ros.core.csam.frame_by_landmarks import MIN_FOUND
from fej_slam_ros.core.csam.join_rules import DEFAULT_RULES, JoinRules
from fej_slam_ros.core.csam.keyframes import Keyframes, RobotStep
from fej_slam_ros.core.csam.rendezvous import RendezvousMeasurement
from fej_slam_ros.core.csam.robot_trajectory import RobotTrajectory, stamped
from fej_slam_ros.core.csam.team_solution import SmoothingTask, solution_hash, TeamMap
from fej_slam_ros.core.definiteness import has_information
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, pose_difference
from fej_slam_ros.core.ordering.team_input import TeamInput
from fej_slam_ros.core.pose_evaluation import PoseScore
from fej_slam_ros.core.records import (
    is_too_uncertain, Motion, Observation, Odometry, PosePrior, Record, RobotObservation,
    RobotScan, Step)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.sentences import reasons_in_words
from fej_slam_ros.core.settings import check_anchor, SmootherSettings
from fej_slam_ros.core.smoothing.incremental import SOLVE_EVERY


class TeamSmoother(TeamInput[PoseEstimate]):
    """
    Trajectories and maps of a team of robots.

    The caller solves: ``smoother.adopt(solve(smoother.task()))``, as often as it likes.

    What is known of a robot that leaves the team stays part of the solutions. If it returns, it is
    lost until it observes some of its landmarks again.

    Parameters
    ----------
    settings : team, its keyframes and handling of its input; a `join_probability` below that of
        `DEFAULT_RULES` is raised to it
    solve_every : minimum number of poses with observations between full solutions of each
        local map

    Attributes
    ----------
    robots : settings of each robot by name, in the order of processing
    trajectories : the trajectory of each robot with odometry, by name
    solution : the last adopted solution
    new_poses : number of poses since the last task that are kept
    new_measurements : number of robot-to-robot observations since then, and of lost robots found
    statistics : counts of the input
    steps : number of steps of each robot
    between_keyframes : number of observations of each robot that no solution has
    odometry : (3,) array for each robot, its pose by odometry alone at its newest pose
    truth : ground truth in the input

    """

    settings: SmootherSettings

    def __init__(self, settings: SmootherSettings, solve_every: int = SOLVE_EVERY) -> None:
        # The map of a single robot stays in its own frame.
        if len(settings.robots) > 1:
            check_anchor(settings)
        super().__init__(settings)
        self.between_keyframes: Counter[str] = Counter()
        self.odometry: dict[str, Array] = {}
        self.trajectories: dict[str, RobotTrajectory] = {}
        self.solution = TeamMap()
        self.new_poses = self.new_measurements = 0
        self._solve_every = solve_every
        self._measurements: list[RendezvousMeasurement] = []
        self._observed_pairs: set[tuple[str, str]] = set()  # observers and observed of these
        self._started_over: set[str] = set()  # robots, since the last task
        self._keyframes = Keyframes(settings.keyframe_distance)
        # Rest of the present step, and the robots whose poses in it are kept.
        self._due: deque[RobotStep] = deque()
        self._due_scans: list[RobotScan] = []
        self._kept: set[str] = set()
        self._stamp = 0

    def add(self, record: Record, received: int | None = None) -> RejectionReason | None:
        """
        Add a record; return the reason if it is rejected, None if it is accepted.

        Odometry that is exact in some direction is rejected; the next one covers its interval.
        `received` is the time of reception [ns] on the clock of the stamp, None to trust the
        stamp.

        """
        if isinstance(record, Odometry) and record.twist_covariance is not None and (
                not has_information(record.twist_covariance)):
            reason = RejectionReason.BAD_COVARIANCE
            self.statistics.reject_message(record.robot, record.stamp, reason)
            return reason
        return super().add(record, received)

    @property
    def is_waiting(self) -> bool:
        """Return whether there is no pose to take before more input."""
        return super().is_waiting and not self._due

    def resume(self) -> None:
        """Continue from a checkpoint; input from before it may be sent again."""
        super().resume()
        # A solution that was being computed is lost.
        self.new_poses += 1

    def task(self) -> SmoothingTask:
        """Return the task of smoothing all input so far, for `solve`."""
        self.new_poses = self.new_measurements = 0
        self._started_over.clear()
        settings = self.settings
        anchor_first = sorted(self._known(), key=lambda name: name != settings.anchor)
        return SmoothingTask(
            tuple(
                self.trajectories[name].local_map('' if settings.shared_landmark_ids else name)
                for name in anchor_first
                if name in self.trajectories and not self.trajectories[name].is_empty()),
            tuple(sorted(self._measurements, key=lambda m: (m.stamp, m.key))),
            settings.anchor, np.array(settings.anchor_pose),
            np.diag(np.square(settings.anchor_sigma)),
            JoinRules(
                settings.join_min_landmarks,
                max(settings.join_probability, DEFAULT_RULES.probability)),
            settings.gate_probability)

    def adopt(self, solution: TeamMap) -> None:
        """
        Adopt the solution of the last task; later poses are estimated from it.

        The map of an unsolved robot is unchanged, and so is that of one that has started over
        since the task.

        """
        solution = solution.without(self._started_over)
        for solved in solution.maps:
            for name in solved.trajectories:
                self.trajectories[name].adopt(solved)
        kept = tuple(
            solved for solved in self.solution.maps
            if solved.trajectories.keys() <= solution.unsolved.keys())
        self.solution = replace(solution, maps=(*solution.maps, *kept))

    def count_outliers(self) -> None:
        """Count what the final solution does not use as rejected observations."""
        for name in self.trajectories:
            self._reject_lost(name)
        for name, outliers in self.solution.outliers.items():
            for outlier in outliers:
                _, id_ = outlier.landmark
                self.statistics.reject_observation(Rejection(
                    name, self.trajectories[name].stamps[outlier.pose], RejectionReason.GATED,
                    id_, outlier.d2, outlier.limit))

    def not_in_map(self) -> dict[str, str]:
        """Return the reason for each robot that is not in ``map``, the most specific one."""
        reasons = {name: self._no_odometry(name) for name in self.robots}
        reasons |= {
            name: self._no_rendezvous(name)
            for name, trajectory in self.trajectories.items()
            if len(trajectory.stamps) > 1 or not self.statistics.rejected[name]}
        for pair in sorted(self._observed_pairs):
            for name, other in permutations(pair):
                if other in self.solution.unsolved:
                    reasons[name] = f'its rendezvous is with {other}, whose map is not solved'
        for solved in self.solution.maps:
            names = solved.trajectories
            if len(names) > 1:
                reasons |= dict.fromkeys(
                    names, f'{" and ".join(names)} have no rendezvous with a robot in {MAP}')
        for failure in self.solution.not_joined:
            if not self.solution.has_joined(failure.robots):
                reasons |= dict.fromkeys(failure.robots, failure.reason)
        reasons |= self.solution.unsolved
        lost = {
            name: trajectory.why_lost() for name, trajectory in self.trajectories.items()
            if trajectory.is_lost}
        return {
            name: reason for name, reason in (reasons | lost).items() if name in lost
            or name not in self.trajectories or self.trajectories[name].frame != MAP}

    def is_smoothed(self, name: str) -> bool:
        """Return whether the last solution has the trajectory of a robot, or it was not tried."""
        return self.solution.has_joined([name]) or name not in self.solution.unsolved

    def scores(self) -> dict[str, PoseScore]:
        """Return the errors of all poses in ``map`` against ground truth, where there is any."""
        scores: dict[str, PoseScore] = {}
        for name, trajectory in self.trajectories.items():
            if trajectory.frame != MAP:
                continue
            known, true = self.truth.find_all(name, trajectory.stamps)
            if len(true):
                scores[name] = PoseScore()
                scores[name].add(
                    pose_difference(trajectory.poses()[known], true),
                    trajectory.covariances()[known])
        return scores

    def state_hash(self) -> str:
        """Return the SHA-256 hash of the last solution."""
        stamps = {name: trajectory.stamps for name, trajectory in self.trajectories.items()}
        return solution_hash(self.solution, self._known(), stamps)

    def _known(self) -> list[str]:
        """Return the robots of the team, then those that have left it."""
        return [*self.robots, *(name for name in self.trajectories if name not in self.robots)]

    def _no_rendezvous(self, name: str) -> str:
        """Return the reason why the map of a robot is not joined with another one."""
        if not self.statistics.observations_used[name]:
            return 'it has observed no landmark or robot'
        if len(self.robots) == 1:
            return 'it is the only robot, and stays in its own frame'
        return 'it has no rendezvous with another robot'

    def _no_odometry(self, name: str) -> str:
        """Return the reason why a robot has no trajectory, or one of a single pose."""
        rejected = self.statistics.rejection_counts[name]
        if not rejected:
            return 'it sent no odometry'
        return f'it sent no usable odometry: {reasons_in_words(rejected)}'

    def _results(self, steps: Iterator[Step]) -> Iterator[PoseEstimate]:
        """Yield the new poses of some steps; a later call continues after a stop."""
        yield from self._rest_of_step()
        for step in steps:
            observations = {scan.robot: scan.observations for scan in step.scans}
            motions = {motion.robot: motion for motion in step.motions}
            self._due.extend(
                (name, motions.get(name), observations.get(name, ()))
                for name in step.odometry)
            self._stamp = step.stamp
            self._choose_keyframes(step.robot_scans)
            self.odometry.update(step.odometry)
            yield from self._rest_of_step()

    def _rest_of_step(self) -> Iterator[PoseEstimate]:
        while self._due:
            yield self._add_pose(*self._due.popleft())
        for scan in self._due_scans:
            for observation in scan.observations:
                self._add_measurement(scan, observation)
        self._due_scans = []

    def _add_measurement(self, scan: RobotScan, observation: RobotObservation) -> None:
        """Add an observation of a robot, unless it is not known where one of the two is."""
        observer = self.trajectories[scan.robot]
        observed = self.trajectories[observation.observed]
        if observer.is_lost or observed.is_lost:
            self.statistics.reject(Rejection(
                scan.robot, scan.stamp, RejectionReason.LOST_ROBOT,
                id=self.sequencer.ids[observation.observed], observed=observation.observed))
            return
        self.statistics.observations_used[scan.robot] += 1
        self._observed_pairs.add((scan.robot, observation.observed))
        self._measurements.append(RendezvousMeasurement(
            scan.robot, len(observer.stamps) - 1, observation.observed, len(observed.stamps) - 1,
            observation.z, observation.R, scan.stamp))
        self.new_measurements += 1

    def _choose_keyframes(self, robot_scans: Sequence[RobotScan]) -> None:
        """Choose which poses and robot-to-robot observations of the present step are kept."""
        self._kept = self._keyframes.choose(self._due)
        self._due_scans = self._keyframes.choose_robot_scans(robot_scans)
        for scan in self._due_scans:
            self._kept.update([scan.robot, *(o.observed for o in scan.observations)])
        for sign, scans in ((1, robot_scans), (-1, self._due_scans)):
            for scan in scans:
                self.between_keyframes[scan.robot] += sign * len(scan.observations)

    def _add_pose(
        self, name: str, motion: Motion | None, observations: tuple[Observation, ...]
    ) -> PoseEstimate:
        was_lost = name in self.trajectories and self.trajectories[name].is_lost
        self._move(name, motion, observations)
        self.statistics.observations_used[name] += len(observations)
        self.steps[name] += 1
        self.new_poses += name in self._kept
        self.new_measurements += was_lost and not self.trajectories[name].is_lost
        return self.trajectories[name].newest()

    def _move(
        self, name: str, motion: Motion | None, observations: tuple[Observation, ...]
    ) -> None:
        """Start a trajectory, or extend it by a pose prior or by odometry."""
        if motion is not None and self._pose_priors.waiting(name):
            self._pose_priors.advance(motion, self.trajectories[name].newest().stamp)
        priors = self._pose_priors.take(name, self._stamp)
        if name not in self.trajectories:
            self.trajectories[name] = RobotTrajectory(
                name, self._stamp, observations, self._solve_every)
            self._reject_priors(priors)
        elif priors and self._place(priors[-1], observations):
            self.statistics.pose_priors_used[name] += len(priors)
        else:
            self._reject_priors(priors)
            self._move_by_odometry(name, motion, observations)

    def _place(self, prior: PosePrior, observations: tuple[Observation, ...]) -> bool:
        """Restart a robot at a prior, or as lost if it is too uncertain; return if it was used."""
        trajectory = self.trajectories[prior.robot]
        is_known = not is_too_uncertain(prior.P)
        if is_known and trajectory.frame != MAP:
            return False
        self._reject_lost(prior.robot)
        if is_known:
            self.statistics.count_restart(prior.robot, 'a pose was given')
            trajectory.place(self._stamp, prior.pose, prior.P, observations)
            self.new_measurements += 1
        else:
            self.statistics.count_restart(prior.robot, 'its pose is not known')
            self._lose(prior.robot, observations)
        return True

    def _lose(self, name: str, observations: tuple[Observation, ...]) -> None:
        """
        Continue in a new frame, until landmarks of the map are observed again.

        Where the map has too few for that, and relates the robot to nothing, it starts over.

        """
        trajectory = self.trajectories[name]
        if len(trajectory.landmark_keys('')) >= MIN_FOUND or self._is_related(name):
            trajectory.lose(self._stamp, observations)
            return
        local = trajectory.local_map('')
        self._reject_observations(name, stamped(
            local.problem.landmarks, trajectory.stamps, [id_ for _, id_ in local.landmarks]))
        self.trajectories[name] = RobotTrajectory(
            name, self._stamp, observations, self._solve_every)
        self.solution = self.solution.without([name])
        self._started_over.add(name)

    def _is_related(self, name: str) -> bool:
        """Return whether the trajectory of a robot has a place in ``map`` or beside another."""
        is_given = name == self.settings.anchor and any(self.settings.anchor_pose)
        return is_given or self.trajectories[name].frame == MAP or any(
            name in (m.observer, m.observed) for m in self._measurements)

    def _reject_lost(self, name: str) -> None:
        """Count observations since a robot was lost, whose poses are in no map, as rejected."""
        self._reject_observations(name, self.trajectories[name].lost_observations())

    def _reject_observations(self, name: str, observed: Iterable[tuple[int, int]]) -> None:
        """Count observations of a robot, given by stamp [ns] and ID, as those of a lost one."""
        for stamp, id_ in observed:
            self.statistics.reject_observation(
                Rejection(name, stamp, RejectionReason.LOST_ROBOT, id_))

    def _reject_priors(self, priors: Iterable[PosePrior]) -> None:
        """Reject poses in ``map`` of a robot for which it is not known where that is."""
        for prior in priors:
            self.statistics.reject(
                Rejection(prior.robot, prior.stamp, RejectionReason.NOT_JOINED))

    def _move_by_odometry(
        self, name: str, motion: Motion | None, observations: tuple[Observation, ...]
    ) -> None:
        trajectory = self.trajectories[name]
        if motion is None or motion.impossible:
            self.statistics.count_restart(
                name, motion.impossible if motion else 'it has returned to the team')
            self._reject_lost(name)
            self._lose(name, observations)
        elif name in self._kept:
            trajectory.add(motion, observations)
        else:
            trajectory.add_between_keyframes(motion, observations)
            self.between_keyframes[name] += len(observations)
