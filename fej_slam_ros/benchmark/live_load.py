# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A large team on topics and its estimator as a process of its own, on this machine only."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import time_ns
from typing import Any

from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node

from fej_slam_ros.benchmark.latency import Traffic
from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.messages import deserialize, RawMessage, restamped, stamp_of
from fej_slam_ros.ros.nodes.child_processes import check_alive, ChildProcesses, keep_to_this_machine
from fej_slam_ros.ros.nodes.ros_process import message_class, reliable, ros, Stop
from fej_slam_ros.ros.session.outputs import DIAGNOSTICS_TOPIC, ROBOT_TYPES, TYPES

POSE = ROBOT_TYPES['pose']
DEPTH = 1000
POLL = 0.05
#: All have found each other after so long [s].
SETTLE = 1.0
#: When no pose has come for so long [s], the estimator has told of the end in diagnostics.
QUIET = 3.0


def run_load(load: Load) -> Traffic:
    """
    Run an estimator on one processor under a load that is sent from the others.

    Raises
    ------
    UserError
        If the estimator fails, or it was interrupted.

    """
    keep_to_this_machine()
    messages = list(load.messages())
    with (
        TemporaryDirectory() as folder, ros([]) as stopped, ChildProcesses() as processes,
        _processors() as (first, *others),
    ):
        parameters = Path(folder) / 'parameters.yaml'
        # JSON is YAML, too.
        parameters.write_text(
            json.dumps({'estimator': {'ros__parameters': load.parameters()}}), encoding='utf-8')
        estimator = processes.start('estimator', parameters)
        os.sched_setaffinity(estimator.pid, {first})
        os.sched_setaffinity(0, others or {first})
        talker = _Talker(messages)
        while not talker.is_connected():
            check_alive(estimator, 'estimator')
            if stopped.is_set():
                raise UserError('interrupted')
        begin, began = _processor_time(estimator.pid), time_ns()
        talker.talk(messages, stopped)
        talker.traffic.cpu = (
            (_processor_time(estimator.pid) - begin) / ((time_ns() - began) * 1e-9))
        talker.listen(QUIET)
        processes.end(estimator)
        talker.close()
        return talker.traffic


class _Talker:
    """Sends prepared messages and takes note of poses."""

    def __init__(self, messages: Iterable[RawMessage]) -> None:
        self.traffic = Traffic()
        self._node = Node('load')
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        types = {message.topic: message.type_name for message in messages}
        self._publishers = {
            topic: self._node.create_publisher(message_class(name), topic, reliable(DEPTH))
            for topic, name in types.items()}
        self._subscriptions = [
            self._subscription(robot)
            for robot in {topic.partition('/')[0] for topic in types}]
        self._node.create_subscription(
            message_class(TYPES[DIAGNOSTICS_TOPIC]), DIAGNOSTICS_TOPIC, self._take_note, reliable(DEPTH),
            raw=True)
        self._last_heard = time_ns()

    def is_connected(self) -> bool:
        """Return whether the estimator is there, after a moment."""
        self._executor.spin_once(POLL)
        ends = [publisher.get_subscription_count() for publisher in self._publishers.values()]
        return all(ends) and all(
            self._node.count_publishers(subscription.topic_name)
            for subscription in self._subscriptions)

    def talk(self, messages: Iterable[RawMessage], stopped: Stop) -> None:
        """Send each message when it is due, stamped with that time."""
        self.listen(SETTLE)
        shift: int | None = None
        for message in messages:
            due = message.received or 0
            shift = time_ns() - due if shift is None else shift
            stamp = due + shift
            raw = restamped(message.raw, stamp)
            while (left := stamp - time_ns()) > 0:
                self._executor.spin_once(left * 1e-9)
            if stopped.is_set():
                raise UserError('interrupted')
            self._publishers[message.topic].publish(raw)
            self.traffic.sent[message.topic.partition('/')[0], stamp] = time_ns()
            self.traffic.messages += 1

    def listen(self, quiet: float) -> None:
        """Listen until nothing has been heard for so long [s]."""
        self._last_heard = time_ns()
        while time_ns() - self._last_heard < quiet * NS:
            self._executor.spin_once(POLL)

    def close(self) -> None:
        """Leave the topics."""
        self._node.destroy_node()

    def _take_note(self, raw: bytes) -> None:
        self.traffic.report.update({
            status.name.rpartition(' ')[2]: {value.key: value.value for value in status.values}
            for status in deserialize(raw, TYPES[DIAGNOSTICS_TOPIC]).status})

    def _subscription(self, robot: str) -> Any:
        def receive(raw: bytes) -> None:
            self._last_heard = time_ns()
            self.traffic.heard[robot, stamp_of(raw)] = self._last_heard

        return self._node.create_subscription(
            message_class(POSE), f'{robot}/pose', receive, reliable(DEPTH), raw=True)


@contextmanager
def _processors() -> Iterator[list[int]]:
    """Yield the processors that this process may use, which it may change meanwhile."""
    before = os.sched_getaffinity(0)
    try:
        yield sorted(before)
    finally:
        os.sched_setaffinity(0, before)


def _processor_time(pid: int) -> float:
    """Return how long a process has used processors [s]."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')
