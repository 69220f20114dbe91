# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All messages that have arrived are handled before a step, in whatever order they are taken."""

from collections import deque
from contextlib import nullcontext
from itertools import count

import pytest

from helpers.optional import optional

event_loop = optional('fej_slam_ros.ros.nodes.event_loop')

pytestmark = pytest.mark.ros


class Backlog:
    """
    A node and its executor after a stall.

    The executor has an event for each message, in the order of arrival; an event of a message
    that was taken before is of no effect.

    """

    is_active, is_behind = True, False

    def __init__(self, topics):
        self._events = deque(enumerate(topics))
        self._odometry = deque(k for k, topic in enumerate(topics) if topic == 'odom')
        self.waiting = len(topics)
        self.callbacks = self.taken = 0
        self.waiting_at_work = None

    def spin_once(self, _timeout):
        if not self._events:
            return
        number, topic = self._events.popleft()
        if topic == 'odom' and number not in self._odometry:
            return
        if topic == 'odom':
            self._odometry.remove(number)
        self._handle()

    def take_odometry(self):
        self.taken += len(self._odometry)
        for _ in range(len(self._odometry)):
            self._odometry.popleft()
            self._handle()

    def work(self):
        self.waiting_at_work = self.waiting

    def write_log(self):
        pass

    def timed_callback(self):
        return nullcontext()

    def _handle(self):
        self.callbacks += 1
        self.waiting -= 1


@pytest.mark.parametrize('seconds', [0.0, 0.02, 0.2])
def test_scans_behind_odometry_that_was_taken_before_are_handled_before_the_step(
        monkeypatch, seconds):
    """A round takes some seconds, so that odometry is taken before its events, or is not."""
    now = count()
    monkeypatch.setattr(event_loop, 'monotonic', lambda: seconds * next(now))
    backlog = Backlog([*(20 * ['odom']), 'landmarks', *(10 * ['odom']), 'landmarks'])

    event_loop.serve(backlog, backlog)

    assert backlog.waiting_at_work == 0
    assert backlog.taken == 0


def test_endless_messages_of_one_topic_do_not_block_the_steps(monkeypatch):
    now = count()
    monkeypatch.setattr(event_loop, 'monotonic', lambda: 0.1 * next(now))
    backlog = Backlog(1000 * ['landmarks'])

    event_loop.serve(backlog, backlog)

    assert 0 < backlog.waiting_at_work < 1000
