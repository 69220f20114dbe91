# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The records of a bag, as an estimator or a smoother would receive them."""

from collections.abc import Iterable
from dataclasses import replace

from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.record_memory import identity, RecordIdentity
from fej_slam_ros.core.records import Received, Record, TrueLandmarks, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.inputs import Inputs


class RecordCollector:
    """
    Collects the valid records of a bag; invalid data is rejected and counted as in a run.

    Attributes
    ----------
    records : the records, each with its time of reception [ns]

    """

    def __init__(self, settings: Settings, needs_ids: bool) -> None:
        self.settings = settings
        self.needs_ids = needs_ids
        self.robots = {robot.name: robot for robot in settings.robots}
        self.statistics = InputStatistics()
        self.records: list[Received] = []
        self._known: set[tuple[str, RecordIdentity]] = set()

    def add(self, record: Record, received: int | None = None) -> None:
        if not isinstance(record, (TruePose, TrueLandmarks)):
            known = record.robot, identity(record)
            if known in self._known:
                self.statistics.reject_record(record, RejectionReason.DUPLICATE)
                return
            self._known.add(known)
        self.records.append((record, received))

    def used(self, robot: str) -> int:
        return sum(getattr(record, 'robot', '') == robot for record, _ in self.records)


def collect(
    messages: Iterable[RawMessage], settings: RunSettings, needs_ids: bool
) -> RecordCollector:
    """
    Return the records in some messages.

    Parameters
    ----------
    messages : in the order of reception
    settings : of the run; a jump back in time is an error
    needs_ids : whether observations without IDs are rejected

    """
    collector = RecordCollector(settings.estimation, needs_ids)
    inputs = Inputs(collector, replace(settings.node, on_time_jump='refuse'))
    inputs.initialpose_robot = settings.estimation.initialpose_robot
    for message in messages:
        inputs.receive(message)
    inputs.close()
    return collector
