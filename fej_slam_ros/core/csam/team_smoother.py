# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The smoother of a team: records in, poses out; what is to be solved out, its solution in.

The live node, the smoothing of a bag and tests drive this one object as they do the estimator.
Solving is left to them: it takes long, and may be done elsewhere while records come in.
"""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from fej_slam_ros.core.consistency import is_definite, pose_error, PoseScore
from fej_slam_ros.core.csam import joining
from fej_slam_ros.core.csam.joining import JoinRules, RendezvousMeasurement
from fej_slam_ros.core.csam.robot_trajectory import RobotTrajectory
from fej_slam_ros.core.csam.team_solution import SmoothingTask, state_hash, TeamMap
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.sequencer import Sequencer
from fej_slam_ros.core.ordering.statistics import InputStatistics
from fej_slam_ros.core.records import (
    Motion, Observation, Odometry, PosePrior, Record, RobotScan, Step, TrueLandmarks, TruePose)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.core.smoothing.incremental import SOLVE_EVERY


@dataclass(frozen=True, slots=True)
class Arrival:
    """The first odometry of a robot."""

    robot: str
    stamp: int


class TeamSmoother:
    """
    A team of robots, each with a map of its own until they meet.

    Parameters
    ----------
    settings : team and handling of its input; a `join_probability` below that of `joining.DEFAULT` is
        raised to it
    solve_every : each map alone is solved for when so many poses have come since it last was

    Attributes
    ----------
    robots : by name, in the order of processing
    ways : of the robots that have been heard
    solution : the last that was adopted
    new_poses, new_meetings : how many have come since the last task
    ledger : what became of the input
    steps : how many steps each robot has had
    truth : ground truth, where there is any

    """

    #: An observation without identity is of no use.
    needs_ids = True

    def __init__(self, settings: CommonSettings, solve_every: int = SOLVE_EVERY) -> None:
        self.settings = settings
        self.robots = {robot.name: robot for robot in settings.robots}
        self.statistics = InputStatistics()
        self.truth = RecordedTruth()
        self.steps: Counter[str] = Counter()
        self.ways: dict[str, RobotTrajectory] = {}
        self.solution = TeamMap()
        self.new_poses = self.new_meetings = 0
        self._solve_every = solve_every
        self._meetings: list[RendezvousMeasurement] = []
        # What is left of the present step: new poses with what was seen from them, and meetings.
        self._due: deque[tuple[Motion | Arrival, tuple[Observation, ...]]] = deque()
        self._due_scans: list[RobotScan] = []
        self._sequencer = Sequencer(settings, self.statistics)

    def add(self, record: Record, received: int | None = None) -> bool:
        """
        Take in a record, and return whether it was not refused at once.

        Odometry whose covariance has no inverse is refused, and bridged as one that was lost is.

        Parameters
        ----------
        record : what was measured
        received : when it was received [ns], on the clock that its stamp is of; None to trust it

        """
        if isinstance(record, TrueLandmarks):
            self.truth.add(record)
            return True
        self.statistics.received[record.robot] += 1
        if isinstance(record, TruePose):
            self.truth.add(record)
            return True
        if isinstance(record, PosePrior):
            raise TypeError('nobody can tell a smoother where a robot is')
        if isinstance(record, Odometry) and _is_exact(record):
            self.statistics.reject(Rejection(record.robot, record.stamp, RejectionReason.BAD_COVARIANCE))
            return False
        return self._sequencer.add(record, received)

    def take(self) -> Iterator[PoseEstimate]:
        """Yield the new poses of the steps that are due; who stops in between may go on later."""
        return self._poses(self._sequencer.take())

    def release(self) -> Iterator[PoseEstimate]:
        """Yield all poses that can be made of the input so far, without waiting for more."""
        return self._poses(self._sequencer.release())

    def close(self) -> Iterator[PoseEstimate]:
        """Yield the last poses: the input has ended."""
        yield from self.release()
        self._sequencer.close()

    def used(self, robot: str) -> int:
        """Return how many messages of a robot have been used."""
        waiting = self._sequencer.waiting(robot)
        return self.statistics.received[robot] - self.statistics.rejected[robot] - waiting

    def task(self) -> SmoothingTask:
        """Return all that is to be solved now."""
        self.new_poses = self.new_meetings = 0
        anchor, shared = self.settings.anchor, self.settings.shared_landmark_ids
        measured = [
            name for name in self.robots if name in self.ways and not self.ways[name].is_empty()]
        maps = (
            self.ways[name].alone('' if shared else name)
            for name in sorted(measured, key=lambda name: name != anchor))
        meetings = sorted(self._meetings, key=lambda met: met.stamp)
        return SmoothingTask(
            tuple(maps), tuple(meetings), anchor, np.array(self.settings.anchor_pose),
            JoinRules(
                self.settings.join_min_landmarks,
                max(self.settings.join_probability, joining.DEFAULT.probability)),
            self.settings.gate_probability)

    def adopt(self, solution: TeamMap) -> None:
        """
        Take over the solution of a task; what came since moves with the last solved poses.

        Where a robot is unsolved its map stays as it was.

        """
        for solved in solution.maps:
            for name in solved.ways:
                self.ways[name].adopt(solved)
        kept = tuple(
            solved for solved in self.solution.maps
            if solved.ways.keys() <= solution.unsolved.keys())
        self.solution = replace(solution, maps=(*solution.maps, *kept))

    def account_outliers(self) -> None:
        """Count the observations that the last solution has left out: there will be no other."""
        for name, outliers in self.solution.outliers.items():
            self.statistics.observations_used[name] -= len(outliers)
            for outlier in outliers:
                _, number = outlier.landmark
                self.statistics.reject(Rejection(
                    name, self.ways[name].stamps[outlier.pose], RejectionReason.GATED, number,
                    outlier.d2, outlier.limit))

    def not_in_map(self) -> dict[str, str]:
        """Return for each robot that is not in ``map``, why."""
        why = {name: self._silence(name) for name in self.robots}
        why |= dict.fromkeys(self.ways, 'it met no other robot')
        for met in self._meetings:
            for name, other in permutations((met.observer, met.seen)):
                if other in self.solution.unsolved:
                    why[name] = f'it met {other}, whose map is not solved'
        for solved in self.solution.maps:
            if len(solved.ways) > 1:
                why |= dict.fromkeys(
                    solved.ways, f'{" and ".join(solved.ways)} met nobody who is in {MAP}')
        for failed in self.solution.not_joined:
            if not self.solution.has_joined(failed.robots):
                why |= dict.fromkeys(failed.robots, failed.reason)
        why |= self.solution.unsolved
        in_map = {name for name, way in self.ways.items() if way.frame == MAP}
        return {name: reason for name, reason in why.items() if name not in in_map}

    def is_believed(self, name: str) -> bool:
        """Return whether a robot's way is one that all it measured could agree on."""
        return self.solution.has_joined([name]) or name not in self.solution.unsolved

    def _silence(self, name: str) -> str:
        """Return why nothing is known of a robot's way."""
        rejected = self.statistics.rejection_counts[name]
        if not rejected:
            return 'it sent no odometry'
        counts = ', '.join(f'{count} {reason.value}' for reason, count in rejected.items())
        return f'it sent no odometry that could be used: {counts}'

    def scores(self) -> dict[str, PoseScore]:
        """Return how all poses in ``map`` compare with ground truth, where there is any."""
        scores: dict[str, PoseScore] = {}
        for name, way in self.ways.items():
            if way.frame != MAP:
                continue
            for estimate in way.estimates():
                if self.truth.covers(name, estimate.stamp):
                    error = pose_error(estimate.pose, self.truth.pose(name, estimate.stamp))
                    scores.setdefault(name, PoseScore()).add(error, estimate.P)
        return scores

    def state_hash(self) -> str:
        """Return SHA-256 over the last solution."""
        stamps = {name: way.stamps for name, way in self.ways.items()}
        return state_hash(self.solution, list(self.robots), stamps)

    def _poses(self, steps: Iterator[Step]) -> Iterator[PoseEstimate]:
        yield from self._rest_of_step()
        for step in steps:
            seen = {scan.robot: scan.observations for scan in step.scans}
            motions = {motion.robot: motion for motion in step.motions}
            self._due.extend(
                (motions.get(name, Arrival(name, step.stamp)), seen.get(name, ()))
                for name in self.robots if name in step.odometry)
            self._due_scans = [*step.robot_scans]
            yield from self._rest_of_step()

    def _rest_of_step(self) -> Iterator[PoseEstimate]:
        while self._due:
            yield self._add_pose(*self._due.popleft())
        newest = {name: len(way.stamps) - 1 for name, way in self.ways.items()}
        for scan in self._due_scans:
            self._meetings += [
                RendezvousMeasurement(
                    scan.robot, newest[scan.robot], observation.seen, newest[observation.seen],
                    observation.z, observation.R, scan.stamp)
                for observation in scan.observations]
            self.new_meetings += len(scan.observations)
        self._due_scans = []

    def _add_pose(self, motion: Motion | Arrival, seen: tuple[Observation, ...]) -> PoseEstimate:
        name = motion.robot
        if isinstance(motion, Arrival):
            self.ways[name] = RobotTrajectory(name, motion.stamp, seen, self._solve_every)
        else:
            self.ways[name].add(motion, seen)
        self.statistics.observations_used[name] += len(seen)
        self.steps[name] += 1
        self.new_poses += 1
        return self.ways[name].newest()


def _is_exact(record: Odometry) -> bool:
    """Return whether odometry claims to be exact in some direction."""
    covariance = record.twist_covariance
    return covariance is not None and not is_definite(covariance)
