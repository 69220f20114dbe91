# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Time of each part of the way of a message through a live estimator, without DDS."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter, process_time
from typing import TypeVar

import numpy as np

from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.core.records import Step
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import RawMessage, serialize
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.live_outputs import LiveOutputs
from fej_slam_ros.ros.topic_types import ODOMETRY

#: Number of robots and of landmarks of each row.
TEAMS = ((2, 20), (2, 500), (20, 500), (50, 500))
#: Rate of the odometry of each robot [Hz]; scans of ten observations come at half of it.
BUDGET_RATE = 20

T = TypeVar('T')


@dataclass(frozen=True)
class MessageBudget:
    """Median times [s] for the messages of a team, and for the steps that they cause."""

    robots: int
    states: int  #: Size of the joint state at the end
    #: From the bytes of odometry, and of a scan, to a record that is in order.
    odometry: float
    scan: float
    order: float  #: Part of a step: which one is due
    #: Prediction of one robot, and the same with the update by its scan.
    odometry_step: float
    scan_step: float
    publish: float  #: Messages of a step and their serialisation
    cpu: float  #: CPU time per second of data, 1 is one processor


class _Stopwatch:
    """Times of the parts of a session, by name [s]."""

    def __init__(self, session: EstimatorSession) -> None:
        self.times: defaultdict[str, list[float]] = defaultdict(list)
        self._session = session
        self._kind = ''
        # Parts within others, which are subtracted from these.
        self._order = self._consumed = 0.0
        estimator = session.estimator
        ordered, results = estimator.sequencer.take, estimator.take
        estimator.sequencer.take = lambda: self._timed(  # type: ignore[method-assign]
            ordered(), self._add_order)
        estimator.take = lambda: self._timed(  # type: ignore[method-assign]
            results(), self._add_step)

    def receive(self, message: RawMessage) -> None:
        """Time the reception of a message."""
        begin = perf_counter()
        for _, publication in self._session.receive(message):
            serialize(publication)
        name = 'odometry' if message.type_name == ODOMETRY else 'scan'
        self.times[name].append(perf_counter() - begin)

    def take(self) -> None:
        """Time the steps that are due."""
        begin, self._consumed, steps = perf_counter(), 0.0, len(self.times['order'])
        for _, publication in self._session.take():
            serialize(publication)
        if len(self.times['order']) > steps:
            self.times['publish'].append(perf_counter() - begin - self._consumed)

    def _timed(
        self, items: Iterator[T], add: Callable[[float, T | None], None]
    ) -> Iterator[T]:
        while True:
            begin = perf_counter()
            item = next(items, None)
            add(perf_counter() - begin, item)
            if item is None:
                return
            yield item

    def _add_order(self, seconds: float, step: Step | None) -> None:
        self._order += seconds
        if step is not None:
            self._kind = 'scan_step' if step.scans else 'odometry_step'

    def _add_step(self, seconds: float, result: object | None) -> None:
        self._consumed += seconds
        if result is not None:
            self.times['order'].append(self._order)
            self.times[self._kind].append(seconds - self._order)
        self._order = 0.0


def message_budget(robots: int, landmarks: int, seconds: int) -> MessageBudget:
    """Run a team for some seconds of its data; the times are those of the second half."""
    load = Load(robots, BUDGET_RATE, landmarks=landmarks, seconds=seconds)
    session = EstimatorSession(parameters.parse(load.parameters()), None, outputs=LiveOutputs)
    session.outputs.is_wanted = lambda topic: False
    messages = [*load.messages()]
    for message in messages[:len(messages) // 2]:
        session.receive(message)
        for _ in session.take():
            pass
    watch, begin = _Stopwatch(session), process_time()
    for message in messages[len(messages) // 2:]:
        watch.receive(message)
        watch.take()
    cpu = (process_time() - begin) / (seconds / 2.0)
    medians = {name: float(np.median(times)) for name, times in watch.times.items()}
    states = session.estimator.groups.team.state.covariance.dimension
    return MessageBudget(robots, states, cpu=cpu, **medians)
