# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages onto topics at their own pace: what plays a bag and what runs a simulated world."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from time import monotonic

from rclpy.node import Node

from fej_slam_ros.ros.messages import outgoing, RawMessage, serialize
from fej_slam_ros.ros.nodes.ros_process import message_class, reliable, Stop, wait_for_arrival

#: Deep enough that a subscriber which stalls for a moment loses nothing.
DEPTH = 1000
#: Simulated time ticks at least this often [s] of real time.
TICK = 0.025
DISCOVERY_POLL = 0.05
#: A subscriber that has been found may take so long to find its publisher in turn [s].
SETTLE = 0.5
#: How often a message says who is still waited for [s].
REMINDER = 5.0


@dataclass(frozen=True)
class Topic:
    """What is to be known of a topic before it can be published."""

    type_name: str
    latched: bool


class Player:
    """
    Publishes messages, reliably, at the times that they carry.

    Parameters
    ----------
    node : whose publishers they are
    topics : all topics, by name
    rate : how many seconds of the messages' time pass in one second
    clock : whether to publish their time on ``/clock``

    """

    def __init__(
        self, node: Node, topics: Mapping[str, Topic], rate: float = 1.0, clock: bool = False
    ) -> None:
        self._node = node
        self._rate = rate
        self._publishers = {
            name: node.create_publisher(
                message_class(topic.type_name), name,
                reliable(1, latched=True) if topic.latched else reliable(DEPTH))
            for name, topic in topics.items()}
        self._clock = (
            node.create_publisher(message_class('rosgraph_msgs/msg/Clock'), '/clock', reliable(10))
            if clock else None)

    def wait_for_subscribers(self, stopped: Stop) -> None:
        """Wait until each topic has a subscriber."""
        remind_at = monotonic() + REMINDER
        while not stopped.is_set():
            missing = [
                name for name, publisher in self._publishers.items()
                if publisher.get_subscription_count() == 0]
            if not missing:
                stopped.wait(SETTLE)
                return
            if monotonic() > remind_at:
                self._node.get_logger().info(f'nobody listens to {", ".join(missing)} yet')
                remind_at += REMINDER
            stopped.wait(DISCOVERY_POLL)

    def play(self, messages: Iterable[RawMessage], stopped: Stop) -> int:
        """Publish messages in their order, each at its time; return how many were published."""
        published, first = 0, None
        began = monotonic()
        for message in messages:
            at = message.received or 0
            first = at if first is None else first
            self._wait_until(began, first, at, stopped)
            if stopped.is_set():
                return published
            self._publishers[message.topic].publish(message.raw)
            published += 1
        wait_for_arrival(self._publishers.values())
        return published

    def _wait_until(self, began: float, first: int, at: int, stopped: Stop) -> None:
        """Wait for the time of a message, ticking."""
        due = began + (at - first) * 1e-9 / self._rate
        while (left := due - monotonic()) > 0.0 and not stopped.is_set():
            self._tick(at - round(left * self._rate * 1e9))
            stopped.wait(min(left, TICK))
        self._tick(at)

    def _tick(self, now: int) -> None:
        if self._clock is not None:
            self._clock.publish(serialize(outgoing.clock(now)))
