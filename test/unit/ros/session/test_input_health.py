# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The use of the input and delays between robots are measured between reports."""

from collections import Counter

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session.input_health import InputHealth, ObservationUse
from helpers.records import MS, team

S = 1000 * MS


def sampled(*totals):
    """Return a robot with totals of (seen, used, gated) observations, reported once a second."""
    use = ObservationUse()
    for second, (seen, used, gated) in enumerate(totals):
        use.sample(second * S, seen, used, Counter({RejectionReason.GATED: gated}))
    return use


def test_the_latest_observations_are_judged():
    use = sampled((20, 20, 0), (40, 40, 0), (50, 42, 8), (60, 43, 17))

    assert use.gated() == (9, 10)


def test_slow_observations_are_collected_over_reports():
    use = sampled(*((k, k // 2, k - k // 2) for k in range(13)))

    assert use.gated() == (5, 10)


def test_old_observations_are_forgotten():
    use = sampled((9, 0, 9), *[(9, 0, 9)] * 31)

    assert use.gated() == (0, 0)


def test_observations_are_unused_since_the_last_used_one():
    use = sampled((3, 3, 0), (6, 3, 0), (9, 3, 0))
    assert (use.unused_since, use.unused_observations) == (0, 6)

    use.sample(3 * S, 12, 5, Counter())
    assert (use.unused_since, use.unused_observations) == (None, 0)


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

    assert (health.robots['r1'].lag(), health.robots['r2'].lag()) == (0, 650 * MS)


def test_a_single_late_message_is_no_delay():
    stamps = [('r1', 0), ('r2', 0), ('r1', 900), ('r2', 900), ('r1', 910), ('r2', 910)]

    assert lags(*stamps, reports=(3, 5)).robots['r2'].lag() == 10 * MS


def test_a_robot_that_is_not_waited_for_delays_nobody():
    stamps = [('r1', 0), ('r2', 0), ('r1', 1000), ('r1', 1500), ('r1', 1600), ('r1', 1700)]

    assert lags(*stamps, reports=(2, 4, 5)).robots['r2'].lag() == 0


def test_a_removed_robot_is_forgotten():
    health = lags(('r1', 0), ('r2', 0))
    health.receive('r2', 'odom', 0)

    health.remove_robot('r2')

    assert health.robots.keys() == {'r1'}
    assert health.flow('r2', 'odom').received == 0
