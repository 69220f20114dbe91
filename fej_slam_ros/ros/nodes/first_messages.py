# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Number of messages that were sent on a topic before the first one that was received."""

from rclpy.node import Node
from rclpy.subscription import Subscription

from fej_slam_ros.ros.nodes.endpoints import taken_message

#: Number of received messages stored per topic while the number is unknown.
MAX_STORED = 50


class FirstMessages:
    """
    Counts the messages missed before the first one received, by the numbers that DDS gives them.

    Callbacks of EventsExecutor cannot have these numbers: rclpy 7.1 fails on the message info. So
    a second subscription, of a hidden node that no executor spins, is polled until it has a
    message that the first subscription received, too.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._hidden: Node | None = None
        self._probes: dict[str, Subscription] = {}
        self._received: dict[str, list[bytes]] = {}

    def watch(self, topic: str, subscription: Subscription) -> None:
        """Watch the topic of a subscription that has not received anything yet."""
        if topic in self._probes:
            return
        if self._hidden is None:
            self._hidden = Node(
                f'_{self._node.get_name()}_first_messages',
                namespace=self._node.get_namespace(), context=self._node.context,
                use_global_arguments=False, start_parameter_services=False, enable_rosout=False)
        self._received[topic] = []
        self._probes[topic] = self._hidden.create_subscription(
            subscription.msg_type, subscription.topic_name, _ignore, subscription.qos_profile,
            raw=True)

    def add(self, topic: str, raw: bytes) -> None:
        """Add a message that was received."""
        if topic in self._probes and len(self._received[topic]) < MAX_STORED:
            self._received[topic].append(raw)

    def missed(self, topic: str) -> int | None:
        """Return the number missed on a topic: None while it is unknown, 0 if not watched."""
        if topic not in self._probes:
            return 0
        received, probe = self._received[topic], self._probes[topic]
        while True:
            taken = taken_message(probe)
            if taken is None:
                return None
            raw, info = taken
            number: int | None = info['publication_sequence_number']
            if number is not None and raw in received:
                return max(0, number - 1 - received.index(raw))

    def forget(self, topic: str) -> None:
        """Watch a topic no longer."""
        if topic in self._probes and self._hidden is not None:
            self._hidden.destroy_subscription(self._probes.pop(topic))
            del self._received[topic]
            if not self._probes:
                self.close()

    def close(self) -> None:
        """Watch nothing any more."""
        self._probes.clear()
        self._received.clear()
        if self._hidden is not None:
            self._hidden.destroy_node()
            self._hidden = None


def _ignore(_raw: bytes) -> None:
    """Stand in for a callback: the messages are polled."""
