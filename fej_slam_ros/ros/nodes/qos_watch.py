# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Endpoints of other nodes whose quality of service is incompatible with that of a node."""

from collections.abc import Iterator
from itertools import product

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSProfile
from rclpy.topic_endpoint_info import TopicEndpointInfo

from fej_slam_ros.ros.session.node_conditions import IncompatibleQos

#: Policies that can make a publisher and a subscription incompatible.
CHECKED_POLICIES = ('reliability', 'durability', 'deadline', 'liveliness')


class QosWatch:
    """
    Finds endpoints of other nodes that are incompatible with those of a node.

    DDS reports when one appears, but not when it disappears, so the graph is checked for that.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._recorded: set[str] = set()

    def subscription_events(self, topic: str) -> SubscriptionEventCallbacks:
        """Return the callbacks that record incompatible publishers on a topic."""
        return SubscriptionEventCallbacks(incompatible_qos=lambda _: self._record(topic))

    def publisher_events(self, topic: str) -> PublisherEventCallbacks:
        """Return the callbacks that record incompatible subscriptions of a topic."""
        return PublisherEventCallbacks(incompatible_qos=lambda _: self._record(topic))

    def incompatible(self) -> list[IncompatibleQos]:
        """Return the present incompatibilities, each once."""
        return list(dict.fromkeys(
            endpoint for topic in sorted(self._recorded) for endpoint in self._endpoints(topic)))

    def _record(self, topic: str) -> None:
        self._recorded.add(self._node.resolve_topic_name(topic))

    def _endpoints(self, topic: str) -> Iterator[IncompatibleQos]:
        publishers = self._node.get_publishers_info_by_topic(topic)
        subscriptions = self._node.get_subscriptions_info_by_topic(topic)
        for publisher, subscription in product(publishers, subscriptions):
            for policy in _disagreements(publisher.qos_profile, subscription.qos_profile):
                if self._is_own(subscription):
                    yield IncompatibleQos(topic, 'subscription', policy)
                elif self._is_own(publisher):
                    yield IncompatibleQos(topic, 'publisher', policy)

    def _is_own(self, endpoint: TopicEndpointInfo) -> bool:
        own = self._node.get_name(), self._node.get_namespace()
        return own == (endpoint.node_name, endpoint.node_namespace)


def _disagreements(offered: QoSProfile, requested: QoSProfile) -> Iterator[str]:
    for policy in CHECKED_POLICIES:
        ends = (
            QoSProfile(depth=1, **{policy: getattr(qos, policy)}) for qos in (offered, requested))
        if qos_check_compatible(*ends)[0] == QoSCompatibility.ERROR:
            yield policy
