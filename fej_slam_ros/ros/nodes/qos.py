# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quality of service of publishers and subscriptions, and its overrides by parameters."""

from rclpy.qos import QoSDurabilityPolicy, QoSPolicyKind, QoSProfile, QoSReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from fej_slam_ros.ros.parameters import QOS_POLICIES
from fej_slam_ros.ros.topic_types import EXCHANGE_TOPIC, LANDMARK_IDS, STATIC_TF, TRUE_LANDMARKS

#: Queue lengths, messages: inputs survive a stall of a second at 200 Hz. Documented in topics.md.
INPUT_DEPTH = 200
OUTPUT_DEPTH = 100
#: Queue length of static transforms, one message for each node that publishes some, as in tf2.
STATIC_DEPTH = 100


def reliable(depth: int, latched: bool = False) -> QoSProfile:
    """Return a reliable profile; latched publishers keep the last message for late subscribers."""
    durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
    return QoSProfile(
        depth=depth, reliability=QoSReliabilityPolicy.RELIABLE, durability=durability)


def best_effort(depth: int) -> QoSProfile:
    """Return a best-effort profile."""
    return QoSProfile(depth=depth, reliability=QoSReliabilityPolicy.BEST_EFFORT)


def input_qos(topic: str) -> QoSProfile:
    """Return the quality of service of a subscription, unless overridden."""
    if topic.endswith(STATIC_TF):
        return reliable(STATIC_DEPTH, latched=True)
    return reliable(1, latched=True) if topic == TRUE_LANDMARKS else best_effort(INPUT_DEPTH)


def output_qos(topic: str) -> QoSProfile:
    """Return the quality of service of a publisher, unless overridden."""
    if topic == EXCHANGE_TOPIC:
        return best_effort(INPUT_DEPTH)
    latched = topic.endswith(('landmarks', 'base_node'))
    return reliable(1, latched=True) if latched else reliable(OUTPUT_DEPTH)


def front_end_qos(topic: str) -> QoSProfile:
    """Return the quality of service of what a front end publishes: landmarks are scans there."""
    return reliable(1, latched=True) if topic == LANDMARK_IDS else reliable(OUTPUT_DEPTH)


def overridable() -> QoSOverridingOptions:
    """Return options that let parameters override every policy."""
    return QoSOverridingOptions([QoSPolicyKind[policy.upper()] for policy in QOS_POLICIES])
