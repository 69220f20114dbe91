# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics (REP-107): the report on a run, its input, and the conditions of its node."""

from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Generic

import numpy as np

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.messages import Message, outgoing
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.session.faults import Fault, Level
from fej_slam_ros.ros.session.input_faults import faults, RobotInput
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.node_conditions import also_published, NodeConditions
from fej_slam_ros.ros.session.outputs import ConsumerT, Publication
from fej_slam_ros.ros.session.percentiles import percentiles
from fej_slam_ros.ros.topic_types import DIAGNOSTICS_TOPIC, MEASUREMENT_TOPICS

#: Period of the reports [s], as REP-107 recommends.
DIAGNOSTICS_PERIOD = 1.0
#: Maximum number of durations stored between two reports: ten seconds of steps at 1 kHz.
MAX_TIMES = 10_000


class Diagnostics(ABC, Generic[ConsumerT]):
    """
    Reports on an estimator or a smoother and its inputs.

    Attributes
    ----------
    settings : of the node at present
    step_times : durations [s] of the steps since the last report, added by the caller
    latencies : delays [s] of the poses published since, from stamp to publication, likewise
    callback_times : durations [s] of the callbacks since, which block all others, likewise
    conditions : of the node, set by the caller
    node_name : name of the node with its namespace, with which the names of statuses begin

    """

    node_name = ''

    def __init__(self, consumer: ConsumerT, inputs: Inputs, settings: NodeSettings) -> None:
        self._consumer = consumer
        self._inputs = inputs
        self.settings = settings
        self._received: Counter[str] = Counter()
        self._reported_at: int | None = None
        self.step_times: deque[float] = deque(maxlen=MAX_TIMES)
        self.latencies: deque[float] = deque(maxlen=MAX_TIMES)
        self.callback_times: deque[float] = deque(maxlen=MAX_TIMES)
        self.conditions = NodeConditions()

    def report(self, now: int, at_rest: bool) -> Publication:
        """
        Return the report at a time [ns]; rates refer to the time since the last report.

        The time is 0 while simulated time has not begun.

        At rest, when the input has paused or ended, the report includes the state hash, which
        takes too long to compute at other times.

        """
        incompatible, file_errors = self.conditions.incompatible, self.conditions.file_errors
        elapsed = 0.0 if not self._reported_at else (now - self._reported_at) / NS
        if now:
            self._inputs.health.sample(now)
        statuses = [
            *self._robots(now, elapsed),
            self._of_errors('qos', [*map(str, incompatible)], 'compatible', {}),
            self._of_errors('files', file_errors.values(), 'no error', file_errors),
            self._overall(now, at_rest)]
        self._reported_at = now
        self._received = self._consumer.statistics.received.copy()
        self.step_times.clear()
        self.latencies.clear()
        self.callback_times.clear()
        return DIAGNOSTICS_TOPIC, outgoing.diagnostics(now, statuses)

    def _input_of(self, robot: str, now: int) -> RobotInput:
        """Return the input of a robot at a time [ns]."""
        return RobotInput(
            robot, now, self._inputs.health, self._needs_observations(robot),
            self.conditions.publishers)

    def input_faults(self, now: int) -> dict[str, str]:
        """Return the conditions of the input of each robot at a time [ns]."""
        return {
            robot: '; '.join(fault.message for fault in faults(self._input_of(robot, now)))
            for robot in self._consumer.robots}

    @abstractmethod
    def _needs_observations(self, robot: str) -> bool:
        """Return whether a robot needs observations to get into ``map``."""

    @abstractmethod
    def _publishes_tf(self) -> bool:
        """Return whether transforms to the odometry frames are published."""

    @abstractmethod
    def _state_of(self, robot: str) -> tuple[Level, str]:
        """Return level and message of a robot for the most serious condition of its estimate."""

    @abstractmethod
    def _values_of(self, robot: str) -> dict[str, object]:
        """Return the values of a robot besides its input statistics."""

    @abstractmethod
    def _overall(self, now: int, at_rest: bool) -> Message:
        """Return the status of the filter or smoother."""

    def _robots(self, now: int, elapsed: float) -> Iterator[Message]:
        statistics, health = self._consumer.statistics, self._inputs.health
        for name in self._consumer.robots:
            since = statistics.received[name] - self._received[name]
            state = self._with_faults(name, now, *self._state_of(name))
            yield outgoing.diagnostic_status(
                f'{self.node_name}: {name}', *state, {
                    'received': statistics.received[name],
                    'used': self._consumer.used(name),
                    'sightings_used': statistics.observations_used[name],
                    'sightings_relaxed': statistics.observations_inflated[name],
                    'rate_hz': round(since / elapsed, 2) if elapsed > 0.0 else 0.0,
                    **{
                        f'{kind}_rate_hz': round(health.flow(name, kind).rate(), 2)
                        for kind in MEASUREMENT_TOPICS},
                    'delays_others_s': round(health.robots[name].lag() / NS, 3),
                    'delay_s': round((health.robots[name].delay or 0) / NS, 6),
                    'released_without': statistics.released_without[name],
                    'located_anew': statistics.relocalized[name],
                    'longest_late_s': round(statistics.longest_delay[name] / NS, 6),
                    **self._values_of(name),
                    **{reason.value: n for reason, n in statistics.rejection_counts[name].items()},
                }, hardware=name)

    def _with_faults(
        self, robot: str, now: int, level: Level, message: str
    ) -> tuple[Level, str]:
        """Add the conditions of the input of a robot to level and message of its estimate."""
        found = faults(self._input_of(robot, now))
        found += [Fault(Level.WARN, fault) for fault in self._inputs.frames.faults(robot)]
        if self._publishes_tf():
            found += [
                Fault(Level.WARN, fault) for fault in self._inputs.frames.ambiguities(robot)]
        others = self.conditions.other_publishers.get(robot)
        if others is not None:
            found.append(Fault(Level.WARN, also_published(others)))
        found += self._clock_faults(robot)
        return (
            max([level, *(fault.level for fault in found)]),
            '; '.join([message, *(fault.message for fault in found)]))

    def _clock_values(self, robot: str) -> dict[str, float]:
        offset = self._inputs.health.clock_offsets.offset(robot)
        return {} if offset is None else {'clock_offset_s': round(offset / NS, 6)}

    def _clock_faults(self, robot: str) -> Iterator[Fault]:
        """Yield the condition that stamps and the clock of reception differ."""
        delay = self._inputs.health.clock_offsets.delay(robot) or 0
        if abs(delay) > self.settings.clock_limit * NS:
            side = 'behind' if delay > 0 else 'ahead of'
            yield Fault(Level.WARN, (
                f'stamps of {robot} are {abs(delay) / NS:.3f} s {side} the clock of reception'))

    def _no_input(self, now: int) -> Fault | None:
        """Return the condition that no robot sends odometry, None if one does."""
        inputs = [self._input_of(robot, now) for robot in self._consumer.robots]
        began = [robot_input for robot_input in inputs if robot_input.flow('odom').received]
        if not began:
            return Fault(Level.WARN, 'no odometry received')
        if all(robot_input.has_stopped('odom') for robot_input in began):
            return Fault(Level.STALE, 'the odometry of all robots has stopped')
        return None

    def _status(
        self, name: str, now: int, warnings: Sequence[str], values: Mapping[str, object]
    ) -> Message:
        """Return a status with warnings, and with an error once time has jumped back."""
        no_input = self._no_input(now)
        messages = [
            *filter(None, [self.conditions.clock_fault]), *warnings,
            *([no_input.message] if no_input else [])]
        if self._consumer.statistics.depends_on_arrival():
            messages.append('the result depended on the order of arrival')
        level = Level.WARN if messages else Level.OK
        time_jump = self._inputs.time_jump_error()
        if time_jump:
            level = Level.ERROR
            messages.insert(0, time_jump)
        elif no_input is not None:
            level = max(level, no_input.level)
        return outgoing.diagnostic_status(
            f'{self.node_name}: {name}', level, '; '.join(messages) or 'running', values)

    def _of_errors(
        self, name: str, errors: Collection[str], if_none: str, values: Mapping[str, str]
    ) -> Message:
        """Return a status of errors; `if_none` is its message without any."""
        return outgoing.diagnostic_status(
            f'{self.node_name}: {name}', Level.ERROR if errors else Level.OK,
            '; '.join(errors) or if_none, values)


def percentile_values(quantity: str, times: Collection[float]) -> dict[str, float]:
    """Return the values of a status for the percentiles of measured times [s]."""
    values = asdict(percentiles(np.array([*times])))
    return {f'{name}_{quantity}_s': round(value, 6) for name, value in values.items()}
