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

from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node

from fej_slam_ros.benchmark.latency import Traffic
from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.child_process import processor_time
from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.messages import deserialize, RawMessage, restamped, stamp_of
from fej_slam_ros.ros.nodes.child_processes import (
    check_alive, ChildProcesses, keep_to_this_machine)
from fej_slam_ros.ros.nodes.endpoints import message_class
from fej_slam_ros.ros.nodes.qos import reliable
from fej_slam_ros.ros.nodes.ros_process import ros, Stop
from fej_slam_ros.ros.topic_types import DIAGNOSTICS_TOPIC, OUTPUT_TYPES, POSE_WITH_COVARIANCE

QUEUE_DEPTH = 1000
#: Interval between two checks of the connections [s].
POLL_INTERVAL = 0.05
#: Time for DDS discovery to complete on both sides after the connections appear [s].
DISCOVERY_TIME = 1.0
#: After this time without a pose [s] the final diagnostics have been received, too.
END_TIMEOUT = 3.0


def run_load(load: Load) -> Traffic:
    """
    Run an estimator on one processor under a load that is sent from the others.

    If the estimator fails, or at an interrupt, raise a `UserError`.
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
        sender = _Sender(messages)
        while not sender.is_connected():
            check_alive(estimator, 'estimator')
            if stopped.is_set():
                raise UserError('interrupted')
        begin, begin_cpu = time_ns(), processor_time(estimator.pid)
        sender.send(messages, stopped)
        sender.traffic.cpu = (
            (processor_time(estimator.pid) - begin_cpu) / ((time_ns() - begin) * 1e-9))
        sender.listen(END_TIMEOUT)
        processes.end(estimator)
        sender.close()
        return sender.traffic


class _Sender:
    """Sends prepared messages and records when poses arrive."""

    def __init__(self, messages: Iterable[RawMessage]) -> None:
        self.traffic = Traffic()
        self._node = Node('load')
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        types = {message.topic: message.type_name for message in messages}
        self._publishers = {
            topic: self._node.create_publisher(message_class(name), topic, reliable(QUEUE_DEPTH))
            for topic, name in types.items()}
        self._pose_topics = [
            self._subscribe_pose(robot) for robot in {topic.partition('/')[0] for topic in types}]
        self._node.create_subscription(
            message_class(OUTPUT_TYPES[DIAGNOSTICS_TOPIC]), DIAGNOSTICS_TOPIC,
            self._receive_diagnostics, reliable(QUEUE_DEPTH), raw=True)
        self._last_received = time_ns()

    def is_connected(self) -> bool:
        """Wait a moment; return whether the estimator is connected to all topics."""
        self._executor.spin_once(POLL_INTERVAL)
        ends = [publisher.get_subscription_count() for publisher in self._publishers.values()]
        return all(ends) and all(map(self._node.count_publishers, self._pose_topics))

    def send(self, messages: Iterable[RawMessage], stopped: Stop) -> None:
        """Send each message when it is due, stamped with that time."""
        self.listen(DISCOVERY_TIME)
        shift: int | None = None
        for message in messages:
            due = message.received or 0
            shift = time_ns() - due if shift is None else shift
            stamp = due + shift
            raw = restamped(message.raw, stamp)
            while (remaining := stamp - time_ns()) > 0:
                self._executor.spin_once(remaining * 1e-9)
            if stopped.is_set():
                raise UserError('interrupted')
            self._publishers[message.topic].publish(raw)
            self.traffic.sent[message.topic.partition('/')[0], stamp] = time_ns()
            self.traffic.messages += 1

    def listen(self, timeout: float) -> None:
        """Listen until no pose has arrived for a time [s]."""
        self._last_received = time_ns()
        while time_ns() - self._last_received < timeout * NS:
            self._executor.spin_once(POLL_INTERVAL)

    def close(self) -> None:
        """Leave the topics."""
        self._node.destroy_node()

    def _receive_diagnostics(self, raw: bytes) -> None:
        self.traffic.diagnostics.update({
            status.name.rpartition(' ')[2]: {value.key: value.value for value in status.values}
            for status in deserialize(raw, OUTPUT_TYPES[DIAGNOSTICS_TOPIC]).status})

    def _subscribe_pose(self, robot: str) -> str:
        """Subscribe to the poses of a robot and return the topic."""
        def receive(raw: bytes) -> None:
            self._last_received = time_ns()
            self.traffic.received[robot, stamp_of(raw)] = self._last_received

        return str(self._node.create_subscription(
            message_class(POSE_WITH_COVARIANCE), f'{robot}/pose', receive,
            reliable(QUEUE_DEPTH), raw=True).topic_name)


@contextmanager
def _processors() -> Iterator[list[int]]:
    """Yield the processors of this process; restore them at the end."""
    before = os.sched_getaffinity(0)
    try:
        yield sorted(before)
    finally:
        os.sched_setaffinity(0, before)
