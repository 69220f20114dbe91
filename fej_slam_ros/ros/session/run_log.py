# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Log of a run: one line for each event, found by comparison with the state before."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Generic, NamedTuple

from fej_slam_ros.core.records import NS
from fej_slam_ros.core.sentences import reasons_in_words
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.log_lines import LogLine, LogSeverity
from fej_slam_ros.ros.session.outputs import ConsumerT
from fej_slam_ros.ros.session.pose_prior_log import PosePriorLog
from fej_slam_ros.ros.session.rejection_cures import description_and_cure
from fej_slam_ros.ros.session.topic_flow import TopicFlow
from fej_slam_ros.ros.topic_types import MEASUREMENT_TOPICS

#: Maximum number of lines that wait to be written; a run without a node writes none.
MAX_LINES = 1000
#: Period of the reminders of missing input, and their maximum number while the same is missing,
#: in calls of `remind`: every 5 s for a minute, since the node calls it once a second.
REMIND_EVERY = 5
MAX_REMINDERS = 12


class Missing(NamedTuple):
    """Input that a run waits for."""

    what: str  #: stays the same while it is missing
    detail: str  #: why, which may change

    def __str__(self) -> str:
        return f'{self.what} ({self.detail})' if self.detail else self.what


class RunLog(ABC, Generic[ConsumerT]):
    """
    The log of one run of an estimator or a smoother.

    Attributes
    ----------
    topic_name : returns the full name of a topic, set by the caller

    """

    def __init__(self, consumer: ConsumerT, inputs: Inputs) -> None:
        self.topic_name: Callable[[str], str] = str
        self._consumer = consumer
        self._inputs = inputs
        self._lines: deque[LogLine] = deque(maxlen=MAX_LINES)
        self._heard: set[str] = set()
        # Time of the newest odometry [ns] of each robot whose odometry has stopped.
        self._stale: dict[str, int] = {}
        self._paused_at: int | None = None  # time of the newest odometry [ns]
        self._has_jumped = False
        self._rejected_topics: set[str] = set()  # of which all messages are rejected
        self._pose_priors = PosePriorLog(consumer, inputs)
        self._missing: Sequence[str] = ()
        self._reminders = 0

    def add(self, severity: LogSeverity, text: str) -> None:
        self._lines.append(LogLine(severity, text))

    def description(self) -> str:
        """Return the team and its estimation in a few words."""
        anchor = self._consumer.settings.anchor
        return 'robots ' + ', '.join(
            f'{name} (anchor)' if name == anchor else name for name in self._consumer.robots)

    def take(self) -> Iterator[LogLine]:
        """Yield and remove the new lines."""
        self._note_first_messages()
        self._lines.extend(self._pose_priors.rejected())
        while self._lines:
            yield self._lines.popleft()

    def check(self, now: int) -> None:
        """Add the lines of input that stopped or is back, and of a jump, at a time [ns]."""
        flows = {
            robot: self._inputs.health.flow(robot, 'odom') for robot in self._consumer.robots}
        # Odometry of later times is from before a clock that went back.
        times = [
            flow.last for flow in flows.values() if flow.last is not None and flow.last <= now]
        if times:
            self._note_pause(now, max(times), flows)
            for robot, flow in flows.items():
                # Robots that all stop at once are no fault of one of them.
                self._note_stale(robot, flow, max(times))
        for robot in self._consumer.robots:
            for kind in MEASUREMENT_TOPICS:
                self._note_rejected_topic(
                    f'{robot}/{kind}', self._inputs.health.flow(robot, kind), now)
        self._note_jump()

    def remind(self, faults: Mapping[str, str] | None) -> None:
        """
        Add a line of what the run waits for, every few calls but not for ever.

        `faults` has the conditions of the input of each robot, None without a clock.

        """
        missing = [Missing('/clock', 'use_sim_time is set')] if faults is None else [
            *self._missing_odometry(faults), *self._needs(faults)]
        what = [item.what for item in missing]
        if what != self._missing:
            self._missing, self._reminders = what, 0
        if not what:
            return
        count, rest = divmod(self._reminders, REMIND_EVERY)
        self._reminders += 1
        if rest == 0 and count < MAX_REMINDERS:
            is_last = count == MAX_REMINDERS - 1
            self.add(LogSeverity.INFO, (
                f'waiting for {"; ".join(map(str, missing))}'
                + (' (last reminder, see /diagnostics)' if is_last else '')))

    @abstractmethod
    def _needs(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        """Yield what the estimate waits for, besides odometry."""

    def _missing_odometry(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        for robot in self._consumer.robots:
            if not self._inputs.health.flow(robot, 'odom').received:
                yield Missing(f'odometry of {robot}', faults[robot])

    def _note_pause(self, now: int, newest: int, flows: Mapping[str, TopicFlow]) -> None:
        stale_after = self._inputs.health.stale_after
        is_paused = all(
            flow.has_stopped(now, stale_after) for flow in flows.values() if flow.received)
        if is_paused and self._paused_at is None:
            self._paused_at = newest
            self.add(LogSeverity.INFO, (
                f'input paused: no odometry of any robot for {(now - newest) / NS:.1f} s'))
        elif self._paused_at is not None and not is_paused:
            gap = (newest - self._paused_at) / NS
            self._paused_at = None
            self.add(LogSeverity.INFO, f'input continues after {gap:.1f} s')

    def _note_stale(self, robot: str, flow: TopicFlow, newest: int) -> None:
        is_stale = flow.has_stopped(newest, self._inputs.health.stale_after)
        if is_stale and robot not in self._stale:
            self._stale[robot] = flow.last or 0
            self.add(LogSeverity.WARN, (
                f'{robot} is stale: no odometry for {flow.silence(newest) / NS:.1f} s, the others'
                ' no longer wait for it'))
        elif robot in self._stale and not is_stale:
            gap = (flow.last or 0) - self._stale.pop(robot)
            self.add(LogSeverity.INFO, f'{robot} is back: odometry after {gap / NS:.1f} s')

    def _note_rejected_topic(self, topic: str, flow: TopicFlow, now: int) -> None:
        is_rejected = flow.are_all_rejected(now) and not flow.is_sent_again()
        if is_rejected and topic not in self._rejected_topics:
            self._rejected_topics.add(topic)
            (reason, _), = flow.rejected_in_a_row.most_common(1)
            _, cure = description_and_cure(topic, reason, self._consumer.settings)
            self.add(LogSeverity.WARN, (
                f'all messages on {self.topic_name(topic)} are rejected:'
                f' {reasons_in_words(flow.rejected_in_a_row)}' + (f': {cure}' if cure else '')))
        elif topic in self._rejected_topics and not flow.rejected_in_a_row:
            self._rejected_topics.remove(topic)
            self.add(
                LogSeverity.INFO, f'messages on {self.topic_name(topic)} are accepted again')

    def _note_priors(self, robot: str, until: int) -> None:
        """Add the lines of the poses that were given to a robot up to a stamp [ns]."""
        self._lines.extend(self._pose_priors.due(robot, until))

    def _note_first_messages(self) -> None:
        first = self._inputs.health.first_messages
        while first:
            robot, kind = first.popleft()
            severity = LogSeverity.DEBUG if robot in self._heard else LogSeverity.INFO
            self._heard.add(robot)
            self.add(severity, f'first data of {robot} on {self.topic_name(f"{robot}/{kind}")}')

    def _note_jump(self) -> None:
        error = self._inputs.time_jump_error()
        if error and not self._has_jumped:
            self._has_jumped = True
            self.add(LogSeverity.ERROR, error)
