# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All messages that have arrived are handled before a step, in whatever order they are taken."""

from collections import Counter, deque
from contextlib import nullcontext

import pytest

from helpers.optional import optional

event_loop = optional('fej_slam_ros.ros.nodes.event_loop')

pytestmark = pytest.mark.ros


class Node:
    """
    A node and its executor.

    The executor has an event for each message and each timer, in the order of arrival; an event of
    a message that was taken before is of no effect. While a message is handled, others arrive.

    """

    is_active, is_behind = True, False

    def __init__(self, events, arriving=()):
        self._events = deque(events)
        self._arriving = deque(arriving)
        self.waiting = Counter(events)
        self.handled = []
        self.taken = 0
        self.waiting_at_work = []

    def spin_once(self, _timeout):
        if self._events:
            self._handle(self._events.popleft())

    def take_messages(self):
        for topic in [topic for topic in self.waiting if topic != 'timer']:
            for _ in range(self.waiting[topic]):
                self._handle(topic)
                self.taken += 1

    def work(self):
        self.waiting_at_work.append(self.waiting.total())

    def write_log(self):
        pass

    def timed_callback(self):
        return nullcontext()

    def _handle(self, topic):
        if not self.waiting[topic]:
            return
        self.waiting[topic] -= 1
        self.handled.append(topic)
        if self._arriving:
            self._events.append(self._arriving[0])
            self.waiting[self._arriving.popleft()] += 1


def test_all_that_has_arrived_during_a_stall_is_handled_before_the_first_step():
    events = [*(20 * ['odom']), 'landmarks', *(10 * ['odom']), 'landmarks']
    node = Node(events)

    event_loop.serve(node, node)

    assert node.waiting_at_work == [0]
    assert sorted(node.handled) == sorted(events)


def test_messages_that_arrive_as_fast_as_they_are_handled_do_not_delay_the_steps():
    # With each one that is handled another arrives: it would last until all 1000 have.
    node = Node(['odom'], 999 * ['odom'])

    event_loop.serve(node, node)

    assert len(node.handled) <= 4


def test_a_timer_waits_for_the_messages_before_it_only():
    node = Node([*(50 * ['odom']), 'timer'], 1000 * ['odom', 'landmarks'])

    rounds = 0
    while 'timer' not in node.handled:
        event_loop.serve(node, node)
        rounds += 1

    assert rounds <= 2
