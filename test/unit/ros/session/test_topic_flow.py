# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rates, gaps and rejections of a topic are measured by time of reception."""

import pytest

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session.topic_flow import TopicFlow
from helpers.records import MS

S = 1000 * MS
STALE_AFTER = 1 * S


def flow(*times):
    """Return a topic whose messages were received at times in ms."""
    topic = TopicFlow()
    for ms in times:
        topic.add(ms * MS)
    return topic


@pytest.mark.parametrize(('times', 'now', 'expected'), [
    ((), 9000, False),
    ((0,), 1000, False), ((0,), 1001, True),
    (range(0, 2000, 100), 2900, False), (range(0, 2000, 100), 2901, True),
    # At 0.5 Hz, one lost message is no stop.
    (range(0, 20000, 2000), 22000, False), (range(0, 20000, 2000), 24001, True),
    # A long pause does not change what is usual.
    ((0, 100, 200, 300, 9000, 9100, 9200, 9300), 10301, True),
    # The clock went back.
    ((5000, 5100), 0, False)])
def test_a_topic_has_stopped_if_it_is_silent_for_longer_than_usual(times, now, expected):
    assert flow(*times).has_stopped(now * MS, STALE_AFTER) is expected


@pytest.mark.parametrize(('times', 'expected'), [
    (range(0, 400, 100), False),
    (range(0, 1000, 100), True),
    # Two messages in a row are lost.
    ((0, 100, 200, 500, 600, 700, 800), True),
    # A detector that only sends what it detects.
    ((0, 100, 200, 5000, 5100, 5200, 9000), False)])
def test_a_topic_is_regular_if_its_gaps_are_alike(times, expected):
    assert flow(*times).is_regular() is expected


def test_a_clock_that_goes_back_is_no_gap():
    topic = flow(1000, 1100, 50, 150)

    assert topic.usual_gap() == 100 * MS


def test_rejections_in_a_row_end_with_an_accepted_message():
    topic = TopicFlow()
    for ms, reason in (0, None), (10, 'late'), (20, 'late'), (30, 'tilted'):
        topic.add(ms * MS)
        topic.settle(ms * MS, reason and RejectionReason(reason))

    assert (topic.rejected_in_a_row, topic.rejected_since) == ({'late': 2, 'tilted': 1}, 10 * MS)
    topic.add(40 * MS)
    topic.settle(40 * MS, None)
    assert not topic.rejected_in_a_row


def test_a_rate_refers_to_the_last_five_seconds():
    topic, rates = TopicFlow(), []
    for second, count in enumerate([0, 10, 20, 30, 40, 50, 50, 50, 50, 50, 50, 50]):
        topic.received = count
        topic.sample(second * S)
        rates.append(topic.rate())

    assert rates[:6] == [0.0, 10.0, 10.0, 10.0, 10.0, 10.0]
    assert rates[6:] == [8.0, 6.0, 4.0, 2.0, 0.0, 0.0]


def test_a_rate_after_the_clock_went_back_is_that_since_then():
    topic = TopicFlow()
    for second, count in ((100, 10), (101, 20), (50, 30), (51, 40)):
        topic.received = count
        topic.sample(second * S)

    assert topic.rate() == 10.0
