# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The number of messages that were sent before the first one received."""

import pytest

from helpers.optional import optional

nav_msgs = optional('nav_msgs.msg')
first_messages = optional('fej_slam_ros.ros.nodes.first_messages')
qos = optional('fej_slam_ros.ros.nodes.qos')

pytestmark = pytest.mark.ros


class Listener:
    """A subscription beside the count of its first messages."""

    def __init__(self, node):
        self.count = first_messages.FirstMessages(node)
        self.received = []
        subscription = node.create_subscription(
            nav_msgs.Odometry, 'r1/odom', self._receive, qos.best_effort(200), raw=True)
        self.count.watch('r1/odom', subscription)

    def missed(self):
        self.number = self.count.missed('r1/odom')
        return self.number

    def _receive(self, raw):
        self.received.append(raw)
        self.count.add('r1/odom', raw)


def odometry(x):
    message = nav_msgs.Odometry()
    message.pose.pose.position.x = float(x)
    return message


@pytest.mark.parametrize('missed', [0, 7])
def test_the_number_is_that_of_the_messages_sent_before(domain, missed):
    publisher = domain.node.create_publisher(
        nav_msgs.Odometry, 'r1/odom', qos.best_effort(200))
    for k in range(missed):
        publisher.publish(odometry(k))
    listener = Listener(domain.node)
    domain.until(lambda: publisher.get_subscription_count() == 2)

    for k in range(3):
        publisher.publish(odometry(100 + k))
    domain.until(lambda: len(listener.received) == 3)

    domain.until(lambda: listener.missed() is not None)
    assert listener.number == missed
    listener.count.close()
    domain.until(lambda: publisher.get_subscription_count() == 1)


def test_the_number_is_unknown_before_a_message_and_zero_for_other_topics(domain):
    listener = Listener(domain.node)

    assert listener.count.missed('r1/odom') is None
    assert listener.count.missed('r2/odom') == 0

    listener.count.forget('r1/odom')
    assert listener.count.missed('r1/odom') == 0


def test_the_node_of_the_count_is_hidden(domain):
    Listener(domain.node)

    others = [name for name in domain.node.get_node_names() if name != domain.node.get_name()]
    # ros2 node list hides names that begin with an underscore.
    assert others == ['_listener_first_messages']
