# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A request of the end: its urgency, and what is still done after it."""

import pytest

from helpers.optional import optional

process = optional('fej_slam_ros.ros.nodes.ros_process')

pytestmark = pytest.mark.ros


def test_an_urgent_request_is_also_one_to_end():
    stop = process.Stop()
    assert not stop.is_urgent()
    stop.set()
    assert not stop.is_urgent()
    stop.set_urgent()
    assert stop.is_urgent()

    stop = process.Stop()
    stop.set_urgent()
    assert stop.is_set()


def test_steps_end_half_a_second_after_the_request_of_the_end(monkeypatch):
    now = [10.0]
    monkeypatch.setattr(process, 'monotonic', lambda: now[0])
    stop = process.Stop()
    now[0] = 20.0
    assert not stop.is_overdue()
    stop.set()
    now[0] = 20.4
    stop.set_urgent()
    assert not stop.is_overdue()
    now[0] = 20.6
    assert stop.is_overdue()
