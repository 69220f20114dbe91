# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The smoother of a team: records in, poses out; what is to be solved out, its solution in.

The live node, the smoothing of a bag and tests drive this one object as they do the estimator.
Solving is left to them: it takes long, and may be done elsewhere while records come in.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fej_slam_ros.core.consistency import is_definite, pose_error, PoseScore
from fej_slam_ros.core.csam import Meeting
from fej_slam_ros.core.estimator import MAP, PoseEstimate
from fej_slam_ros.core.ledger import Ledger
from fej_slam_ros.core.records import (
    GivenPose, Odometry, Record, Refusal, Rejection, RobotScan, Step, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.core.smoother import SOLVE_EVERY
from fej_slam_ros.core.stream import Stream
from fej_slam_ros.core.team_map import state_hash, Task, TeamMap
from fej_slam_ros.core.truth import RecordedTruth
from fej_slam_ros.core.way import Way


@dataclass(frozen=True, slots=True, eq=False)
class SmootherStep:
    """The poses that are new at a stamp [ns], in the order of the robots."""

    stamp: int
    poses: tuple[PoseEstimate, ...]


class TeamSmoother:
    """
    A team of robots, each with a map of its own until they meet.

    Parameters
    ----------
    settings : what the user chose; what only the filter knows is ignored
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

    def __init__(self, settings: Settings, solve_every: int = SOLVE_EVERY) -> None:
        self.settings = settings
        self.robots = {robot.name: robot for robot in settings.robots}
        self.ledger = Ledger()
        self.truth = RecordedTruth()
        self.steps: Counter[str] = Counter()
        self.ways: dict[str, Way] = {}
        self.solution = TeamMap()
        self.new_poses = self.new_meetings = 0
        self._solve_every = solve_every
        self._meetings: list[Meeting] = []
        self._stream = Stream(settings, self.ledger)

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
        self.ledger.received[record.robot] += 1
        if isinstance(record, TruePose):
            self.truth.add(record)
            return True
        if isinstance(record, GivenPose):
            raise TypeError('nobody can tell a smoother where a robot is')
        if isinstance(record, Odometry) and record.twist_covariance is not None and (
                not is_definite(record.twist_covariance)):
            self.ledger.refuse(
                Rejection(record.robot, record.stamp, Refusal.BAD_COVARIANCE))
            return False
        return self._stream.add(record, received)

    def take(self) -> Iterator[SmootherStep]:
        """Yield the steps that are finished."""
        return map(self._step, self._stream.take())

    def release(self) -> Iterator[SmootherStep]:
        """Yield all steps that can be made of the input so far, without waiting for more."""
        return map(self._step, self._stream.release())

    def close(self) -> Iterator[SmootherStep]:
        """Yield the last steps: the input has ended."""
        yield from self.release()
        self._stream.close()

    def used(self, robot: str) -> int:
        """Return how many messages of a robot have been used."""
        waiting = self._stream.waiting(robot)
        return self.ledger.received[robot] - self.ledger.refused[robot] - waiting

    def task(self) -> Task:
        """Return all that is to be solved now."""
        self.new_poses = self.new_meetings = 0
        anchor, shared = self.settings.anchor, self.settings.shared_landmark_ids
        names = sorted(
            (name for name in self.robots if name in self.ways), key=lambda name: name != anchor)
        return Task(
            tuple(
                self.ways[name].alone('' if shared else name) for name in names
                if not self.ways[name].is_empty()),
            tuple(self._meetings), anchor, np.array(self.settings.anchor_pose),
            self.settings.join_min_landmarks)

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

    def not_in_map(self) -> dict[str, str]:
        """Return for each robot that is not in ``map``, why."""
        why = dict.fromkeys(self.robots, 'it sent no odometry')
        why |= dict.fromkeys(self.ways, 'it met no other robot')
        for failed in self.solution.not_joined:
            why |= dict.fromkeys(failed.robots, failed.reason)
        why |= self.solution.unsolved
        in_map = {name for name, way in self.ways.items() if way.frame == MAP}
        return {name: reason for name, reason in why.items() if name not in in_map}

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

    def _step(self, step: Step) -> SmootherStep:
        """Let one stamp happen: new poses, and what was seen from them."""
        seen = {scan.robot: scan.sightings for scan in step.scans}
        for name in step.arrivals:
            self.ways[name] = Way(name, step.stamp, seen.get(name, ()), self._solve_every)
        for motion in step.motions:
            self.ways[motion.robot].add(motion, seen.get(motion.robot, ()))
        for name, sightings in seen.items():
            self.ledger.sightings_used[name] += len(sightings)
        for robots in step.robot_scans:
            self._meet(robots)
        self.steps.update(step.odometry.keys())
        self.new_poses += len(step.odometry)
        here = [name for name in self.robots if name in step.odometry]
        return SmootherStep(step.stamp, tuple(self.ways[name].newest() for name in here))

    def _meet(self, scan: RobotScan) -> None:
        """Keep which robots, all of them here, were seen from which pose."""
        newest = {name: len(way.stamps) - 1 for name, way in self.ways.items()}
        self._meetings += [
            Meeting(
                scan.robot, newest[scan.robot], sighting.seen, newest[sighting.seen],
                sighting.z, sighting.R)
            for sighting in scan.sightings]
        self.new_meetings += len(scan.sightings)
