# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The input of a team, which the estimator and the smoother have in common."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Generic, TypeVar

from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.pose_priors import PosePriors
from fej_slam_ros.core.ordering.sequencer import Sequencer
from fej_slam_ros.core.records import (
    Odometry, PosePrior, Received, Record, RobotScan, Scan, Step, TrueLandmarks, TruePose)
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import CommonSettings, RobotSettings


#: Result of a step, or of a robot in it.
ResultT = TypeVar('ResultT')


class TeamInput(ABC, Generic[ResultT]):
    """Base of the estimator and of the smoother: it takes records of all kinds, in any order."""

    needs_ids = True  #: whether observations without IDs are rejected

    def __init__(self, settings: CommonSettings) -> None:
        self.settings = settings
        self.robots = {robot.name: robot for robot in settings.robots}  #: in processing order
        self.statistics = InputStatistics()
        self.truth = RecordedTruth()
        self.sequencer = Sequencer(settings, self.statistics)  #: the waiting measurements
        self.steps: Counter[str] = Counter()  #: number of steps of each robot
        self._pose_priors = PosePriors(self.statistics)

    def change_team(self, robots: Sequence[RobotSettings]) -> None:
        """Change the team, whose robots are given in the order of processing."""
        before, self.robots = self.robots, {robot.name: robot for robot in robots}
        for name in before:
            if name not in self.robots:
                self._pose_priors.leave(name)
        self.sequencer.change_team(robots)

    def add(self, record: Record, received: int | None = None) -> RejectionReason | None:
        """
        Add a record; return the reason if it is rejected, None if it is accepted.

        Parameters
        ----------
        record : measurement, initial pose or ground truth
        received : time of reception [ns] on the clock of the stamp, None if it is unknown

        """
        if isinstance(record, TrueLandmarks):
            self.truth.add(record)
            return None
        self.statistics.received[record.robot] += 1
        if isinstance(record, (Odometry, Scan, RobotScan)):
            return self.sequencer.add(record, received)
        reason: RejectionReason | None
        if record.robot not in self.robots:
            reason = RejectionReason.UNKNOWN_ROBOT
        elif isinstance(record, TruePose):
            reason = self._add_true_pose(record)
        elif self.settings.is_future(record.stamp, received):
            reason = RejectionReason.FUTURE
        else:
            return self._add_pose_prior(record)
        return None if reason is None else self.statistics.reject_record(record, reason)

    def run(self, records: Iterable[Record]) -> Iterator[ResultT]:
        """Add all records and close; yield each result as soon as it is there."""
        return self.run_received((record, None) for record in records)

    def run_received(self, records: Iterable[Received]) -> Iterator[ResultT]:
        """Add all records, each with its time of reception [ns] or None, and close, as `run`."""
        for record, received in records:
            self.add(record, received)
            yield from self.take()
        yield from self.close()

    @property
    def is_waiting(self) -> bool:
        """Return whether there is no result to take before more input."""
        return self.sequencer.is_waiting

    def take(self) -> Iterator[ResultT]:
        """
        Yield the results of the steps that wait for no more input.

        The result of an estimator's step is a `StepResult`; a smoother has a `PoseEstimate` for
        each robot of the step. A later call continues where this one is stopped.

        """
        return self._results(self.sequencer.take())

    def release(self) -> Iterator[ResultT]:
        """Yield the results of all steps that the input so far allows, without waiting."""
        return self._results(self.sequencer.release())

    def close(self) -> Iterator[ResultT]:
        """Yield the last results, and reject what no odometry has reached: the input has ended."""
        yield from self.release()
        self.sequencer.close()
        self._pose_priors.close()

    def resume(self) -> None:
        """Continue from a checkpoint; input from before it may be sent again."""
        self.sequencer.resume()

    def used(self, robot: str) -> int:
        """Return the number of messages of a robot that were used."""
        waiting = self.sequencer.waiting(robot) + self._pose_priors.waiting(robot)
        return self.statistics.received[robot] - self.statistics.rejected[robot] - waiting

    @abstractmethod
    def _results(self, steps: Iterator[Step]) -> Iterator[ResultT]:
        """Yield the results of some steps."""

    def _add_true_pose(self, record: TruePose) -> RejectionReason | None:
        """Add ground truth; return the reason if it is rejected."""
        return self.truth.add(record)

    def _add_pose_prior(self, record: PosePrior) -> RejectionReason | None:
        """Add a pose prior; the step that uses a delayed one depends on its arrival."""
        reason = self._pose_priors.add(record)
        if reason is None and self.sequencer.has_processed(record.robot, record.stamp):
            self.statistics.released_without[record.robot] += 1
        return reason
