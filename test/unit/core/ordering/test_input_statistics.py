# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every message and observation is counted once, as used or rejected."""

from collections import Counter

import pytest

from fej_slam_ros.core.ordering.input_statistics import InputStatistics, MAX_PENDING_REJECTIONS
from fej_slam_ros.core.rejections import Rejection, RejectionReason


def test_a_rejected_message_counts_as_received_and_rejected():
    statistics = InputStatistics()

    statistics.reject_message('r1', 5, RejectionReason.LATE)

    assert statistics.received == {'r1': 1}
    assert statistics.rejected == {'r1': 1}
    assert statistics.rejection_counts == {'r1': {RejectionReason.LATE: 1}}
    assert list(statistics.rejections) == [Rejection('r1', 5, RejectionReason.LATE)]


def test_a_rejected_observation_does_not_count_as_a_rejected_message():
    statistics = InputStatistics()

    statistics.reject(Rejection('r1', 5, RejectionReason.GATED, id=0))

    assert statistics.received['r1'] == statistics.rejected['r1'] == 0
    assert statistics.total(RejectionReason.GATED) == 1


def test_a_scan_of_rejected_observations_only_counts_as_a_rejected_message_without_a_reason():
    statistics = InputStatistics()

    statistics.count_fully_rejected_scan('r1')

    assert (statistics.received['r1'], statistics.rejected['r1']) == (1, 1)
    assert not statistics.rejection_counts
    assert not statistics.rejections


def test_totals_add_up_over_robots_and_the_longest_delay_is_kept_per_robot():
    statistics = InputStatistics()

    for robot, delay in [('r1', 30), ('r1', 10), ('r2', 20)]:
        statistics.reject(Rejection(robot, 5, RejectionReason.LATE, delay=delay))
    statistics.reject(Rejection('r2', 5, RejectionReason.TILTED))

    assert statistics.total(RejectionReason.LATE) == 3
    assert statistics.total(RejectionReason.TILTED) == 1
    assert statistics.longest_delay == {'r1': 30, 'r2': 20}


def test_only_the_newest_rejections_wait_to_be_published_and_all_are_counted():
    statistics = InputStatistics()

    for stamp in range(MAX_PENDING_REJECTIONS + 1):
        statistics.reject_message('r1', stamp, RejectionReason.BAD_STAMP)

    assert len(statistics.rejections) == MAX_PENDING_REJECTIONS
    assert statistics.rejections[0].stamp == 1
    assert statistics.total(RejectionReason.BAD_STAMP) == MAX_PENDING_REJECTIONS + 1


def test_the_counts_of_a_robot_are_replaced_by_those_taken_over_and_no_others():
    statistics, other = InputStatistics(), InputStatistics()
    for counted in statistics, other:
        counted.count_fully_rejected_scan('r2')
    statistics.reject_message('r1', 5, RejectionReason.TILTED)
    for stamp in 6, 7:
        other.reject_message('r1', stamp, RejectionReason.LATE)
        other.count_fully_rejected_scan('r2')
    other.count_restart('r1', 'lost')
    other.observations_used['r1'], other.released_without['r1'] = 3, 4

    statistics.take_over('r1', other)

    assert statistics.received == statistics.rejected == {'r1': 2, 'r2': 1}
    assert statistics.rejection_counts == {'r1': {RejectionReason.LATE: 2}}
    assert (statistics.relocalized, statistics.restart_reasons) == ({'r1': 1}, {'r1': 'lost'})
    assert (statistics.observations_used, statistics.released_without) == ({'r1': 3}, {'r1': 4})


def test_no_count_of_a_robot_is_left_out_when_it_is_taken_over():
    statistics, other = InputStatistics(), InputStatistics()
    counts = [name for name, counted in vars(other).items() if isinstance(counted, Counter)]
    for number, name in enumerate(counts, start=1):
        vars(other)[name]['r1'] = number
        vars(statistics)[name].update(r1=100, r2=200)

    statistics.take_over('r1', other)

    taken = {name: (vars(statistics)[name]['r1'], vars(statistics)[name]['r2']) for name in counts}
    assert len(counts) >= 8
    assert taken == {name: (number, 200) for number, name in enumerate(counts, start=1)}


def test_later_rejections_of_a_robot_do_not_count_where_it_was_taken_over():
    statistics, other = InputStatistics(), InputStatistics()
    other.reject_message('r1', 5, RejectionReason.LATE)
    statistics.take_over('r1', other)

    other.reject_message('r1', 6, RejectionReason.LATE)

    assert statistics.rejection_counts == {'r1': {RejectionReason.LATE: 1}}


@pytest.mark.parametrize('reason', RejectionReason)
def test_the_result_depends_on_arrival_after_what_time_of_arrival_and_speed_decide_only(reason):
    statistics = InputStatistics()

    statistics.reject_message('r1', 5, reason)

    assert statistics.depends_on_arrival() is (
        reason.value in ('late', 'conflicting', 'overload', 'interrupted'))


def test_the_result_depends_on_arrival_after_a_step_without_a_slow_robot():
    statistics = InputStatistics()
    assert not statistics.depends_on_arrival()

    statistics.released_without['r1'] += 1

    assert statistics.depends_on_arrival()
