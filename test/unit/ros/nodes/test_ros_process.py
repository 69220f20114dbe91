# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A signal at any moment ends a wait for it."""

import signal
from time import monotonic

import pytest

from helpers.optional import optional

process = optional('fej_slam_ros.ros.nodes.ros_process')

pytestmark = pytest.mark.ros


@pytest.fixture
def alarms():
    """Return a function that has a signal come every 0.3 ms, and end what is current."""
    current = []
    before = signal.signal(signal.SIGALRM, lambda *_: current[-1].set())

    def start(stop):
        current.append(stop)
        signal.setitimer(signal.ITIMER_REAL, 3e-4, 3e-4)

    yield start
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, before)


def test_a_signal_may_come_at_any_moment_of_a_wait(alarms):
    # A threading.Event does not survive the first of these on most machines.
    for _ in range(2000):
        with process.Stop() as stop:
            alarms(stop)
            while not stop.is_set():
                stop.wait(1e-5)


def test_an_urgent_request_is_also_one_to_end():
    with process.Stop() as stop:
        assert not stop.is_urgent()
        stop.set()
        assert not stop.is_urgent()
        stop.set_urgent()
        assert stop.is_urgent()

    with process.Stop() as stop:
        stop.set_urgent()
        assert stop.is_set()


def test_a_request_that_is_set_ends_every_wait():
    with process.Stop() as stop:
        stop.set()
        stop.set()
        began = monotonic()
        stop.wait(60.0)

    assert stop.is_set()
    assert monotonic() - began < 30.0


def test_steps_end_half_a_second_after_the_request_of_the_end(monkeypatch):
    now = [10.0]
    monkeypatch.setattr(process, 'monotonic', lambda: now[0])
    with process.Stop() as stop:
        now[0] = 20.0
        assert not stop.is_overdue()
        stop.set()
        now[0] = 20.4
        stop.set_urgent()
        assert not stop.is_overdue()
        now[0] = 20.6
        assert stop.is_overdue()
