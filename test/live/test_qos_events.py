# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Incompatible QoS is reported in diagnostics with the topic and the parameter to set."""

import pytest

from helpers.optional import optional
from helpers.ros import ODOMETRY

live_helpers = optional('helpers.live')
endpoints = optional('fej_slam_ros.ros.nodes.endpoints')
qos = optional('fej_slam_ros.ros.nodes.qos')
Duration = optional('rclpy.duration').Duration
QoSProfile = optional('rclpy.qos').QoSProfile

pytestmark = pytest.mark.ros

TEAM = {'robots': ['r1']}
CLOUD = 'sensor_msgs/msg/PointCloud2'
OK, ERROR = 0, 2
RELIABLE = {'qos_overrides./r1/odom.subscription.reliability': 'reliable'}


@pytest.fixture
def qos_status(domain):
    """Return a function that starts an estimator and returns its latest QoS status."""

    def start(**values):
        domain.estimate(**TEAM, **values)
        reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)

        def newest():
            return [
                (status.level, status.message) for report in reports[-1:]
                for status in report.status if status.name == 'estimator: qos']

        return newest

    return start


def publish(domain, topic, type_name, qos):
    return domain.node.create_publisher(endpoints.message_class(type_name), topic, qos)


def subscribe(domain, topic, type_name, qos):
    return domain.node.create_subscription(
        endpoints.message_class(type_name), topic, lambda _: None, qos, raw=True)


@pytest.mark.slow
def test_compatible_topics_are_ok(domain, qos_status):
    newest = qos_status()

    publisher = publish(domain, 'r1/odom', ODOMETRY, qos.best_effort(10))
    domain.until(lambda: publisher.get_subscription_count() and newest())

    assert newest() == [(OK, 'compatible')]


@pytest.mark.parametrize(
    ('topic', 'type_name', 'given', 'sentence'),
    [
        ('r1/odom', ODOMETRY, RELIABLE,
         ('/r1/odom: a publisher offers BEST_EFFORT, this node requests RELIABLE:'
          ' set qos_overrides./r1/odom.subscription.reliability: best_effort')),
        ('ground_truth/landmarks', CLOUD,
         {'qos_overrides./ground_truth/landmarks.subscription.reliability': 'best_effort'},
         ('/ground_truth/landmarks: a publisher offers VOLATILE, this node requests'
          ' TRANSIENT_LOCAL: set qos_overrides./ground_truth/landmarks.subscription.durability:'
          ' volatile')),
    ],
)
def test_an_incompatible_publisher_is_an_error_with_topic_and_parameter(
    domain, qos_status, topic, type_name, given, sentence,
):
    newest = qos_status(**given)

    publish(domain, topic, type_name, qos.best_effort(10))

    domain.until(lambda: newest() == [(ERROR, sentence)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ('wanted', 'given', 'sentence'),
    [
        (qos.reliable(1, latched=True), {},
         ('/r1/pose: a subscription requests TRANSIENT_LOCAL, this node offers VOLATILE:'
          ' set qos_overrides./r1/pose.publisher.durability: transient_local')),
        (qos.reliable(1), {'qos_overrides./r1/pose.publisher.reliability': 'best_effort'},
         ('/r1/pose: a subscription requests RELIABLE, this node offers BEST_EFFORT:'
          ' set qos_overrides./r1/pose.publisher.reliability: reliable')),
        (QoSProfile(depth=1, deadline=Duration(seconds=0.5)), {},
         ('/r1/pose: a subscription requests a deadline that this node does not offer:'
          ' remove it from that subscription')),
    ],
)
def test_an_incompatible_subscription_is_an_error(domain, qos_status, wanted, given, sentence):
    newest = qos_status(**given)

    subscribe(domain, 'r1/pose', live_helpers.POSE, wanted)

    domain.until(lambda: newest() == [(ERROR, sentence)])


@pytest.mark.slow
def test_each_incompatible_policy_is_reported_until_its_endpoint_is_gone(domain, qos_status):
    newest = qos_status()

    publisher = publish(domain, 'ground_truth/landmarks', CLOUD, qos.best_effort(10))
    domain.until(lambda: [level for level, _ in newest()] == [ERROR])
    (_, message), = newest()
    domain.node.destroy_publisher(publisher)

    assert 'reliability: best_effort' in message
    assert 'durability: volatile' in message
    domain.until(lambda: newest() == [(OK, 'compatible')])


def test_the_suggested_parameters_make_topics_compatible(domain, qos_status):
    topic = 'qos_overrides./ground_truth/landmarks.subscription'
    newest = qos_status(
        **{f'{topic}.reliability': 'best_effort', f'{topic}.durability': 'volatile'})

    publisher = publish(domain, 'ground_truth/landmarks', CLOUD, qos.best_effort(10))
    domain.until(lambda: publisher.get_subscription_count() and newest())

    assert newest() == [(OK, 'compatible')]
