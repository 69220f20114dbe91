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
        # The second subscription of each topic, and the messages that the first has received.
        self._watched: dict[str, tuple[Subscription, list[bytes]]] = {}

    def watch(self, topic: str, subscription: Subscription) -> None:
        """Watch the topic of a subscription that has not received anything yet."""
        if topic in self._watched:
            return
        if self._hidden is None:
            self._hidden = Node(
                f'_{self._node.get_name()}_first_messages',
                namespace=self._node.get_namespace(), context=self._node.context,
                use_global_arguments=False, start_parameter_services=False, enable_rosout=False)
        probe = self._hidden.create_subscription(
            subscription.msg_type, subscription.topic_name, lambda _raw: None,
            subscription.qos_profile, raw=True)
        self._watched[topic] = probe, []

    def add(self, topic: str, raw: bytes) -> None:
        """Add a message that was received."""
        if topic in self._watched:
            _, received = self._watched[topic]
            if len(received) < MAX_STORED:
                received.append(raw)

    def missed(self, topic: str) -> int | None:
        """Return the number missed on a topic: None while it is unknown, 0 if not watched."""
        if topic not in self._watched:
            return 0
        probe, received = self._watched[topic]
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
        if topic in self._watched and self._hidden is not None:
            probe, _ = self._watched.pop(topic)
            self._hidden.destroy_subscription(probe)
            if not self._watched:
                self.close()

    def close(self) -> None:
        """Watch nothing any more."""
        self._watched.clear()
        if self._hidden is not None:
            self._hidden.destroy_node()
            self._hidden = None
