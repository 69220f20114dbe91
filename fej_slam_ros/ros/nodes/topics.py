# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publishers and subscriptions of a node, which change with its team."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from time import monotonic

from rclpy.lifecycle import LifecyclePublisher
from rclpy.subscription import Subscription

from fej_slam_ros.ros.messages import prepare, serialize
from fej_slam_ros.ros.nodes.endpoints import message_class, taken_message, wait_for_arrival
from fej_slam_ros.ros.nodes.first_messages import FirstMessages
from fej_slam_ros.ros.nodes.managed_node import ManagedNode
from fej_slam_ros.ros.nodes.qos import INPUT_DEPTH, input_qos, output_qos, overridable
from fej_slam_ros.ros.nodes.qos_watch import QosWatch
from fej_slam_ros.ros.session.input_faults import TopicPublishers
from fej_slam_ros.ros.session.node_conditions import IncompatibleQos
from fej_slam_ros.ros.session.outputs import Publication

#: Time [s] for which Fast DDS may list the publishers of a killed node, and some more.
MAX_MATCHED_AFTER_DEATH = 22.0


class NodeTopics:
    """
    Publishers and subscriptions of a node; every quality of service can be overridden.

    Parameters
    ----------
    receive : called with topic, type name and bytes of each message

    Attributes
    ----------
    first_messages : number of messages missed on the topics that `watch_first` was called for

    """

    def __init__(self, node: ManagedNode, receive: Callable[[str, str, bytes], None]) -> None:
        self._node = node
        self._receive = receive
        self._qos = QosWatch(node)
        self.first_messages = FirstMessages(node)
        self._publishers: dict[str, LifecyclePublisher] = {}
        # Since when [s] others publish the pose of a robot, by robot and names.
        self._others_since: dict[tuple[str, str], float] = {}
        self._subscriptions: dict[str, Subscription] = {}

    def match_outputs(self, types: Mapping[str, str], active: bool) -> None:
        """Create the publishers of some topics, given with their types, and destroy all others."""
        for topic in [topic for topic in self._publishers if topic not in types]:
            self._node.destroy_lifecycle_publisher(self._publishers.pop(topic))
        for topic, type_name in types.items():
            if topic not in self._publishers:
                publisher = self._publishers[topic] = self._publisher(topic, type_name)
                if active:
                    publisher.on_activate(None)

    def match_inputs(self, types: Mapping[str, str]) -> None:
        """Create the subscriptions of some topics, given with their types; destroy all others."""
        for topic in [topic for topic in self._subscriptions if topic not in types]:
            self.first_messages.forget(topic)
            self._node.destroy_subscription(self._subscriptions.pop(topic))
        for topic, type_name in types.items():
            if topic not in self._subscriptions:
                self._subscriptions[topic] = self._subscription(topic, type_name)

    def watch_first(self, topics: Iterable[str]) -> None:
        """Watch inputs for messages that are sent before the first one received."""
        for topic in topics:
            self.first_messages.watch(topic, self._subscriptions[topic])

    def take(self, kind: str = '') -> int:
        """
        Receive the messages that have arrived on all topics, or on those of a kind such as odom.

        The executor is not used: it would also call services and timers. Return their number.

        """
        taken = 0
        for topic, subscription in [*self._subscriptions.items()]:
            # A message may begin a new run with other topics.
            if topic in self._subscriptions and (not kind or topic.endswith(f'/{kind}')):
                taken += self._take_all(subscription)
        return taken

    def _take_all(self, subscription: Subscription) -> int:
        for taken in range(INPUT_DEPTH):
            message = taken_message(subscription)
            if message is None:
                return taken
            subscription.callback(message[0])
        return INPUT_DEPTH

    def publish(self, publications: Iterable[Publication]) -> int:
        """Publish messages and return their number."""
        published = 0
        for topic, message in publications:
            self._publishers[topic].publish(serialize(message))
            published += 1
        return published

    def is_wanted(self, topic: str) -> bool:
        """Return whether a topic has subscribers."""
        return self._publishers[topic].get_subscription_count() > 0

    def wait_for_arrival(self, is_urgent: Callable[[], bool] = lambda: False) -> None:
        """Wait until the subscribers have acknowledged all messages, if they do so."""
        wait_for_arrival(self._publishers.values(), is_urgent)

    def incompatible(self) -> list[IncompatibleQos]:
        """Return the topics whose quality of service is incompatible at present."""
        return self._qos.incompatible()

    def publishers(
        self, incompatible: Iterable[IncompatibleQos]
    ) -> dict[str, TopicPublishers]:
        """Return the publishers on each input topic, by its relative name."""
        reasons = {qos.topic: str(qos) for qos in incompatible}
        found = {}
        for topic, subscription in self._subscriptions.items():
            name = subscription.topic_name
            types = [
                endpoint.topic_type
                for endpoint in self._node.get_publishers_info_by_topic(name)]
            found[topic] = TopicPublishers(name, tuple(types), reasons.get(name, ''))
        return found

    def other_publishers(self) -> dict[str, str]:
        """Return by robot the other nodes that publish its pose too, for longer than a moment."""
        own, now = self._node.get_fully_qualified_name(), monotonic()
        since = {}
        for topic, publisher in self._publishers.items():
            robot, _, kind = topic.rpartition('/')
            if kind == 'pose':
                names = [
                    f'{endpoint.node_namespace.rstrip("/")}/{endpoint.node_name}'
                    for endpoint in self._node.get_publishers_info_by_topic(publisher.topic_name)]
                # A node of the same name is another one.
                others = ', '.join(sorted((Counter(names) - Counter([own])).elements()))
                if others:
                    since[robot, others] = self._others_since.get((robot, others), now)
        self._others_since = since
        return {
            robot: others for (robot, others), begin in since.items()
            if now - begin > MAX_MATCHED_AFTER_DEATH}

    def _publisher(self, topic: str, type_name: str) -> LifecyclePublisher:
        prepare(type_name)
        publisher: LifecyclePublisher = self._node.create_lifecycle_publisher(
            message_class(type_name), topic, output_qos(topic),
            event_callbacks=self._qos.publisher_events(topic),
            qos_overriding_options=overridable())
        return publisher

    def _subscription(self, topic: str, type_name: str) -> Subscription:
        def receive(raw: bytes) -> None:
            self.first_messages.add(topic, raw)
            self._receive(topic, type_name, raw)

        prepare(type_name)
        return self._node.create_subscription(
            message_class(type_name), topic, receive, input_qos(topic), raw=True,
            event_callbacks=self._qos.subscription_events(topic),
            qos_overriding_options=overridable())
