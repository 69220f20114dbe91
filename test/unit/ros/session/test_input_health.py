# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rates, gaps, rejections and use of the input are measured by time of reception."""

from collections import Counter

import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session.input_health import InputHealth, RobotHealth, TopicFlow
from helpers.records import MS, team

S = 1000 * MS
STALE_AFTER = 1 * S


def flow(*times):
    """Return a topic whose messages were received at times in ms."""
    topic = TopicFlow()
    for ms in times:
        topic.add(ms * MS, None)
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
        topic.add(ms * MS, reason and RejectionReason(reason))

    assert (topic.rejected_in_a_row, topic.rejected_since) == ({'late': 2, 'tilted': 1}, 10 * MS)
    topic.add(40 * MS, None)
    assert not topic.rejected_in_a_row


def test_a_rate_refers_to_the_last_five_seconds():
    topic, rates = TopicFlow(), []
    for second, count in enumerate([0, 10, 20, 30, 40, 50, 50, 50, 50, 50, 50, 50]):
        topic.received = count
        topic.sample(second * S)
        rates.append(topic.rate())

    assert rates[:6] == [0.0, 10.0, 10.0, 10.0, 10.0, 10.0]
    assert rates[6:] == [8.0, 6.0, 4.0, 2.0, 0.0, 0.0]


def sampled(*totals):
    """Return a robot with totals of (seen, used, gated) observations, reported once a second."""
    health = RobotHealth()
    for second, (seen, used, gated) in enumerate(totals):
        health.sample(second * S, seen, used, Counter({RejectionReason.GATED: gated}))
    return health


def test_the_latest_observations_are_judged():
    health = sampled((20, 20, 0), (40, 40, 0), (50, 42, 8), (60, 43, 17))

    assert health.gated() == (9, 10)


def test_slow_observations_are_collected_over_reports():
    health = sampled(*((k, k // 2, k - k // 2) for k in range(13)))

    assert health.gated() == (5, 10)


def test_old_observations_are_forgotten():
    health = sampled((9, 0, 9), *[(9, 0, 9)] * 31)

    assert health.gated() == (0, 0)


def test_observations_are_unused_since_the_last_used_one():
    health = sampled((3, 3, 0), (6, 3, 0), (9, 3, 0))
    assert (health.unused_since, health.unused_observations) == (0, 6)

    health.sample(3 * S, 12, 5, Counter())
    assert (health.unused_since, health.unused_observations) == (None, 0)


def lags(*stamps, reports=()):
    """Return the health of r1 and r2 after odometry stamps (robot, ms), a report after some."""
    health = InputHealth(Estimator(team('r1', 'r2')))
    for k, (robot, ms) in enumerate(stamps):
        health.receive_odometry(robot, ms * MS)
        if k in reports:
            health.sample(ms * MS)
    return health


def test_a_robot_delays_others_by_the_lead_of_their_odometry():
    stamps = [('r2', 0), ('r1', 0), ('r1', 700), ('r2', 750), ('r1', 750), ('r1', 1400)]

    health = lags(*stamps, reports=(2, 5))

    assert (health.lag('r1'), health.lag('r2')) == (0, 650 * MS)


def test_a_single_late_message_is_no_delay():
    stamps = [('r1', 0), ('r2', 0), ('r1', 900), ('r2', 900), ('r1', 910), ('r2', 910)]

    assert lags(*stamps, reports=(3, 5)).lag('r2') == 10 * MS


def test_a_robot_that_is_not_waited_for_delays_nobody():
    stamps = [('r1', 0), ('r2', 0), ('r1', 1000), ('r1', 1500), ('r1', 1600), ('r1', 1700)]

    assert lags(*stamps, reports=(2, 4, 5)).lag('r2') == 0


def test_a_removed_robot_is_forgotten():
    health = lags(('r1', 0), ('r2', 0))
    health.receive('r2', 'odom', 0, None)

    health.remove_robot('r2')

    assert health.newest == {'r1': 0}
    assert health.flow('r2', 'odom').received == 0
