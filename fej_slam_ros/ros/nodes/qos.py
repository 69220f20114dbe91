# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service: what of it may be overridden, and who does not fit."""

from collections.abc import Iterator
from itertools import product

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.topic_endpoint_info import TopicEndpointInfo

from fej_slam_ros.ros.parameters import QOS_POLICIES
from fej_slam_ros.ros.session.diagnostics import IncompatibleQos

#: Policies by which a publisher and a subscription can miss each other.
AGREED = ('reliability', 'durability', 'deadline', 'liveliness')


def overridable() -> QoSOverridingOptions:
    """Return that every policy of ours can be overridden by a parameter."""
    return QoSOverridingOptions([QoSPolicyKind[policy.upper()] for policy in QOS_POLICIES])


class QosWatch:
    """
    Finds ends of topics elsewhere that do not fit those of a node.

    DDS tells when one appears, but not when it is gone: that the graph tells.

    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._noted: set[str] = set()

    def subscription_events(self, topic: str) -> SubscriptionEventCallbacks:
        """Return what notes incompatible publishers on a topic."""
        return SubscriptionEventCallbacks(incompatible_qos=lambda _: self._note(topic))

    def publisher_events(self, topic: str) -> PublisherEventCallbacks:
        """Return what notes incompatible subscriptions of a topic."""
        return PublisherEventCallbacks(incompatible_qos=lambda _: self._note(topic))

    def incompatible(self) -> list[IncompatibleQos]:
        """Return what does not fit at present, each once."""
        found = (misfit for topic in sorted(self._noted) for misfit in self._misfits(topic))
        return list(dict.fromkeys(found))

    def _note(self, topic: str) -> None:
        self._noted.add(self._node.resolve_topic_name(topic))

    def _misfits(self, topic: str) -> Iterator[IncompatibleQos]:
        publishers = self._node.get_publishers_info_by_topic(topic)
        subscriptions = self._node.get_subscriptions_info_by_topic(topic)
        for publisher, subscription in product(publishers, subscriptions):
            for policy in _disagreements(publisher.qos_profile, subscription.qos_profile):
                if self._is_own(subscription):
                    yield IncompatibleQos(topic, 'subscription', policy)
                elif self._is_own(publisher):
                    yield IncompatibleQos(topic, 'publisher', policy)

    def _is_own(self, end: TopicEndpointInfo) -> bool:
        own = self._node.get_name(), self._node.get_namespace()
        return own == (end.node_name, end.node_namespace)


def _disagreements(offered: QoSProfile, wanted: QoSProfile) -> Iterator[str]:
    """Yield each policy that alone would keep the ends apart."""
    for policy in AGREED:
        ends = (
            QoSProfile(depth=1, **{policy: getattr(qos, policy)}) for qos in (offered, wanted))
        if qos_check_compatible(*ends)[0] == QoSCompatibility.ERROR:
            yield policy
