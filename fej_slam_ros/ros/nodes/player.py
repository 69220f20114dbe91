# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publish messages at the times they carry, from a bag or a simulated world."""

from collections.abc import Collection, Iterable, Mapping
from time import monotonic

from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.messages import outgoing, RawMessage, serialize
from fej_slam_ros.ros.nodes.endpoints import check_topic_names, message_class, wait_for_arrival
from fej_slam_ros.ros.nodes.qos import reliable, STATIC_DEPTH
from fej_slam_ros.ros.nodes.ros_process import Stop
from fej_slam_ros.ros.topic_types import STATIC_TF

#: Queue length of the publishers, messages: a subscriber may stall for seconds without loss.
PLAYED_DEPTH = 1000
#: Longest period of /clock and of answers to services [s of real time]; rviz2 and timers need a
#: clock of at least 40 Hz.
CLOCK_PERIOD = 0.025
#: Period of the check for subscribers [s].
SUBSCRIBER_CHECK_PERIOD = 0.05
#: Longest wait [s] until all known subscribers are connected; those of incompatible quality of
#: service never are.
MAX_CONNECTION_WAIT = 10.0
#: Wait [s] after the publishers have discovered all subscribers, for discovery the other way.
DISCOVERY_WAIT = 0.5
#: Period of the log message about topics without a subscriber [s].
REMINDER_PERIOD = 5.0


class Player:
    """
    Publishes messages, reliably, at the times they carry; its node answers services meanwhile.

    Parameters
    ----------
    types : of all topics, by name
    latched : topics whose last message is kept for late subscribers; of static transforms all
        are, since each is of another node
    rate : seconds of message time per second of real time
    clock : whether to publish the message time on ``/clock``
    no_wait : what the user gives to begin without subscribers

    """

    def __init__(
        self, node: Node, types: Mapping[str, str], latched: Collection[str], rate: float,
        clock: bool, no_wait: str = '--no-wait',
    ) -> None:
        self._node = node
        self._no_wait = no_wait
        self._executor = EventsExecutor()
        self._executor.add_node(node)
        self._answered_at, self._rate = 0.0, rate
        check_topic_names(node, types)
        self._publishers = {
            name: node.create_publisher(
                message_class(type_name), name, _qos(name, name in latched))
            for name, type_name in types.items()}
        self._clock = (
            node.create_publisher(message_class('rosgraph_msgs/msg/Clock'), '/clock', reliable(10))
            if clock else None)

    def wait_for_subscribers(self, stopped: Stop) -> None:
        """Wait until each topic has a subscriber, and all that are known are connected."""
        remind_at = monotonic() + REMINDER_PERIOD
        while missing := self._unsubscribed():
            self._spin(monotonic() + SUBSCRIBER_CHECK_PERIOD, stopped)
            if stopped.is_set():
                return
            if monotonic() > remind_at:
                self._node.get_logger().info(
                    f'waiting for subscribers of {", ".join(missing)}; to begin without them, give'
                    f' {self._no_wait}')
                remind_at += REMINDER_PERIOD
        self._wait_for_connections(stopped)
        self._spin(monotonic() + DISCOVERY_WAIT, stopped)

    def run(self, messages: Iterable[RawMessage], wait: bool, stopped: Stop) -> None:
        """Wait for subscribers if required, and play until the end or an interrupt."""
        if wait:
            self.wait_for_subscribers(stopped)
        self.play(messages, stopped)
        self._node.destroy_node()

    def play(self, messages: Iterable[RawMessage], stopped: Stop) -> None:
        """Publish messages in their order, each at its time."""
        began, first = monotonic(), None
        for message in messages:
            at = message.received or 0
            first = at if first is None else first
            self._wait_until(began, first, at, stopped)
            if stopped.is_set():
                break
            self._publishers[message.topic].publish(message.raw)
        wait_for_arrival(self._publishers.values(), stopped.is_set)

    def _wait_for_connections(self, stopped: Stop) -> None:
        """Wait until all known subscribers are connected, also to /clock; name the others."""
        give_up = monotonic() + MAX_CONNECTION_WAIT
        while (missing := self._unconnected()) and not stopped.is_set():
            if monotonic() > give_up:
                self._node.get_logger().warning(
                    f'not all subscribers are connected: {"; ".join(missing)}: check their types'
                    ' and quality of service')
                return
            self._spin(monotonic() + SUBSCRIBER_CHECK_PERIOD, stopped)

    def _unconnected(self) -> list[str]:
        """Return the topics with more subscribers than are connected, with their nodes."""
        found = []
        for publisher in [*self._publishers.values(), *filter(None, [self._clock])]:
            known = self._node.get_subscriptions_info_by_topic(publisher.topic_name)
            connected = publisher.get_subscription_count()
            if len(known) > connected:
                nodes = ', '.join(sorted(subscriber.node_name for subscriber in known))
                found.append(
                    f'{connected} of {len(known)} of {publisher.topic_name} ({nodes})')
        return found

    def _unsubscribed(self) -> list[str]:
        """Return the topics without a subscriber."""
        return [
            name for name, publisher in self._publishers.items()
            if publisher.get_subscription_count() == 0]

    def _wait_until(self, began: float, first: int, at: int, stopped: Stop) -> None:
        """Wait until the time of a message, publishing the clock."""
        due = began + (at - first) / NS / self._rate
        while (remaining := due - monotonic()) > 0.0 and not stopped.is_set():
            self._tick(at - round(remaining * self._rate * NS))
            self._spin(min(due, monotonic() + CLOCK_PERIOD), stopped)
        if monotonic() - self._answered_at > CLOCK_PERIOD:
            # Playback cannot keep up and never waits.
            self._answer(0.0)
        self._tick(at)

    def _spin(self, end: float, stopped: Stop) -> None:
        """Answer services until a time of `monotonic`, or until the end is requested."""
        while (remaining := end - monotonic()) > 0.0 and not stopped.is_set():
            self._answer(min(remaining, CLOCK_PERIOD))

    def _answer(self, timeout: float) -> None:
        """Answer service requests, or wait for one until a timeout [s]."""
        self._executor.spin_once(timeout)
        self._answered_at = monotonic()

    def _tick(self, now: int) -> None:
        if self._clock is not None:
            self._clock.publish(serialize(outgoing.clock(now)))


def _qos(topic: str, latched: bool) -> QoSProfile:
    if topic.rpartition('/')[2] == STATIC_TF:
        return reliable(STATIC_DEPTH, latched=True)
    return reliable(1, latched=True) if latched else reliable(PLAYED_DEPTH)
