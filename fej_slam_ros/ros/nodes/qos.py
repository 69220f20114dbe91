# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service: what of it may be overridden, and who does not fit."""

from collections.abc import Iterator
from typing import Any

from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility, QoSPolicyKind, QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

from fej_slam_ros.ros.diagnostics import IncompatibleQos
from fej_slam_ros.ros.parameters import QOS_POLICIES

#: Policies by which a publisher and a subscription can miss each other.
AGREED = ('reliability', 'durability', 'deadline', 'liveliness', 'liveliness_lease_duration')


def overridable() -> QoSOverridingOptions:
    """Return that every policy of ours can be overridden by a parameter."""
    return QoSOverridingOptions([QoSPolicyKind[policy.upper()] for policy in QOS_POLICIES])


class QosWatch:
    """
    Finds ends of topics elsewhere that do not fit those of a node.

    DDS tells when one appears but not when it is gone; that, the graph tells.

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
        return list(dict.fromkeys([*self._publishers(), *self._subscriptions()]))

    def _note(self, topic: str) -> None:
        self._noted.add(self._node.resolve_topic_name(topic))

    def _publishers(self) -> Iterator[IncompatibleQos]:
        for own in self._node.subscriptions:
            if (topic := own.topic_name) in self._noted:
                for end in self._node.get_publishers_info_by_topic(topic):
                    yield from _misfits(topic, 'subscription', end.qos_profile, own.qos_profile)

    def _subscriptions(self) -> Iterator[IncompatibleQos]:
        for own in self._node.publishers:
            if (topic := own.topic_name) in self._noted:
                for end in self._node.get_subscriptions_info_by_topic(topic):
                    yield from _misfits(topic, 'publisher', own.qos_profile, end.qos_profile)


def _misfits(
    topic: str, own: str, offered: QoSProfile, wanted: QoSProfile
) -> Iterator[IncompatibleQos]:
    for policy in AGREED:
        values = getattr(offered, policy), getattr(wanted, policy)
        ends = (QoSProfile(depth=1, **{policy: value}) for value in values)
        if qos_check_compatible(*ends)[0] == QoSCompatibility.ERROR:
            yield IncompatibleQos(topic, own, policy, *map(_told, values))


def _told(value: Any) -> str:
    """Return the name of a policy, or how long a time is."""
    return f'{value.nanoseconds * 1e-9:g} s' if isinstance(value, Duration) else value.name
