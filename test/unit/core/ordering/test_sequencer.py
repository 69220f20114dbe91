# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Order in time across robots: which steps come out, and when; max_delay 100 ms, stale 1 s."""

from itertools import permutations

import numpy as np
import pytest

from fej_slam_ros.core.ordering.record_memory import FORGOTTEN_TOGETHER, MAX_REMEMBERED
from fej_slam_ros.core.ordering.robot_queue import MAX_QUEUED_SCANS
from fej_slam_ros.core.pieces import between_pieces
from fej_slam_ros.core.rejections import RejectionReason
from helpers.records import (
    A_NANOSECOND, all_steps, fed, MS, odometry, robot_scan, scan, sequencer_of, team)

A_LANDMARK = [(1, (2.0, 0.0))]
ANOTHER = [(2, (0.0, 2.0))]


def stamps(steps):
    return [step.stamp / MS for step in steps]


def moved(step):
    return [motion.robot for motion in step.motions]


def stamps_of(robot, steps):
    return stamps(step for step in steps if robot in step.arrivals or robot in moved(step))


def rejection_counts(statistics, robot='r1'):
    return {reason: n for reason, n in statistics.rejection_counts[robot].items() if n}


def test_every_stamp_with_odometry_or_a_scan_is_one_step():
    sequencer, _ = sequencer_of('r1')

    steps = all_steps(
        sequencer, odometry('r1', 0), scan('r1', 100), odometry('r1', 200), scan('r1', 200),
        scan('r1', 250), odometry('r1', 400))

    assert stamps(steps) == [0, 100, 200, 250, 400]
    assert [len(step.scans) for step in steps] == [0, 1, 1, 1, 0]
    assert [step.arrivals for step in steps] == [('r1',), (), (), (), ()]


def test_equal_stamps_of_all_robots_are_one_step_in_the_order_of_the_robots():
    sequencer, _ = sequencer_of('r1', 'r2')

    first, second = all_steps(
        sequencer, odometry('r2', 0), odometry('r1', 0), scan('r2', 100), odometry('r2', 100),
        odometry('r1', 100), scan('r1', 100))

    assert first.arrivals == ('r1', 'r2')
    assert moved(second) == ['r1', 'r2']
    assert [a_scan.robot for a_scan in second.scans] == ['r1', 'r2']


def test_a_stamp_of_one_robot_moves_no_other():
    sequencer, _ = sequencer_of('r1', 'r2')

    steps = all_steps(
        sequencer, odometry('r1', 0), odometry('r2', 0), scan('r2', 50), odometry('r1', 80),
        odometry('r1', 100), odometry('r2', 100))

    assert stamps(steps) == [0, 50, 80, 100]
    assert [moved(step) for step in steps] == [[], ['r2'], ['r1'], ['r1', 'r2']]


@pytest.mark.parametrize('slower', ['r1', 'r2'])
def test_an_event_is_released_when_all_robots_have_passed_it_by_more_than_max_delay(slower):
    faster = 'r2' if slower == 'r1' else 'r1'
    sequencer, _ = sequencer_of('r1', 'r2')

    assert not fed(
        sequencer, odometry('r1', 0), odometry('r2', 0), odometry(faster, 300),
        odometry(slower, 100))
    assert stamps(fed(sequencer, odometry(slower, 100 + A_NANOSECOND))) == [0]


def test_scans_release_no_events():
    sequencer, _ = sequencer_of('r1')

    assert not fed(sequencer, odometry('r1', 0), scan('r1', 500), scan('r1', 900))


def test_processing_begins_once_all_robots_have_sent_odometry():
    sequencer, _ = sequencer_of('r1', 'r2')

    assert not fed(sequencer, odometry('r1', 0), odometry('r1', 200), odometry('r1', 300))
    assert stamps(fed(sequencer, odometry('r2', 300))) == [0]


def test_processing_does_not_begin_with_a_scan_alone():
    sequencer, _ = sequencer_of('r1', 'r2')

    assert not fed(sequencer, odometry('r1', 0), odometry('r1', 200), scan('r2', 200))


def test_processing_begins_without_a_silent_robot_when_another_leads_by_stale_after():
    sequencer, _ = sequencer_of('r1', 'r2')

    assert not fed(sequencer, odometry('r1', 5500), odometry('r1', 5000), odometry('r1', 5999))
    assert stamps(fed(sequencer, odometry('r1', 6001))) == [5000, 5500]


def test_a_robot_that_never_sent_odometry_delays_no_other():
    sequencer, _ = sequencer_of('r1', 'r2')
    fed(sequencer, odometry('r1', 0), odometry('r1', 1001))

    assert stamps(fed(sequencer, odometry('r1', 1200), odometry('r1', 1301))) == [1001, 1200]


def test_a_robot_delays_others_until_they_lead_by_more_than_stale_after_and_max_delay():
    sequencer, statistics = sequencer_of('r1', 'r2')

    assert not fed(
        sequencer, odometry('r1', 0), odometry('r2', 0), odometry('r1', 500), odometry('r1', 1100))
    steps = fed(sequencer, odometry('r1', 1100 + A_NANOSECOND))

    assert stamps(steps) == [0, 500]
    assert steps[0].arrivals == ('r1', 'r2')
    assert statistics.released_without.total() == 0


@pytest.mark.parametrize('late', [0, 50, 99])
def test_scans_within_a_long_gap_are_released_at_its_end(late):
    arriving = [(ms, odometry('r1', ms)) for ms in range(0, 3000, 100)]
    arriving += [(0, odometry('r2', 0)), (500 + late, scan('r2', 500)),
                 (1050 + late, odometry('r2', 1050)), (1150, odometry('r2', 1150))]
    sequencer, _ = sequencer_of('r1', 'r2')

    steps = all_steps(sequencer, *(record for _, record in sorted(arriving, key=lambda a: a[0])))

    order = stamps(steps)
    assert order[order.index(1000) + 1:][:3] == [500, 1050, 1100]


def test_late_data_of_a_stale_robot_is_used_in_its_own_order_and_counted():
    sequencer, statistics = sequencer_of('r1', 'r2')
    fed(
        sequencer, odometry('r1', 0), odometry('r2', 0), odometry('r1', 3000),
        odometry('r1', 5000))

    steps = all_steps(
        sequencer, scan('r2', 250), odometry('r2', 100), odometry('r2', 200), odometry('r2', 400),
        scan('r2', 500, A_LANDMARK), odometry('r2', 600))

    assert stamps_of('r2', steps) == [100, 200, 250, 400, 500, 600]
    assert [len(step.scans) for step in steps if moved(step) == ['r2']] == [0, 0, 1, 0, 1, 0]
    assert statistics.released_without == {'r2': 6}
    assert statistics.depends_on_arrival()
    assert statistics.rejected.total() == 0


def test_a_robot_that_caught_up_is_waited_for_again():
    sequencer, _ = sequencer_of('r1', 'r2')
    fed(sequencer, odometry('r1', 0), odometry('r2', 0), odometry('r1', 3000))

    steps = fed(sequencer, odometry('r2', 2500), odometry('r1', 3200))

    assert 3000 not in stamps(steps)
    assert 3000 in stamps(fed(sequencer, odometry('r2', 3101)))


def test_a_robot_that_shares_a_stamp_too_late_makes_a_step_of_its_own():
    sequencer, statistics = sequencer_of('r1', 'r2')
    fed(sequencer, odometry('r1', 0), odometry('r2', 0), odometry('r1', 500), odometry('r1', 1500))

    steps = all_steps(sequencer, odometry('r2', 500))

    assert stamps_of('r2', steps) == [500]
    assert statistics.released_without == {'r2': 1}


def test_a_scan_before_the_first_odometry_is_rejected():
    sequencer, statistics = sequencer_of('r1', 'r2')

    steps = all_steps(
        sequencer, odometry('r1', 50), odometry('r1', 60), scan('r2', 50), scan('r2', 55),
        odometry('r2', 60))

    assert stamps(steps) == [50, 60]
    assert steps[0].arrivals == ('r1',)
    assert rejection_counts(statistics, 'r2') == {RejectionReason.BEFORE_ODOMETRY: 2}


def test_a_scan_after_the_newest_odometry_waits_for_the_next():
    sequencer, _ = sequencer_of('r1')

    assert stamps(all_steps(sequencer, odometry('r1', 0), scan('r1', 50))) == [0]
    assert sequencer.waiting('r1') == 1
    assert stamps(all_steps(sequencer, odometry('r1', 100))) == [50, 100]
    assert sequencer.waiting('r1') == 0


def test_scans_beyond_the_last_odometry_are_rejected_at_the_end():
    sequencer, statistics = sequencer_of('r1', 'r2')
    all_steps(
        sequencer, odometry('r1', 0), scan('r1', 50, A_LANDMARK), scan('r1', 50, ANOTHER),
        scan('r2', 10))

    sequencer.close()

    assert rejection_counts(statistics, 'r1') == {RejectionReason.AFTER_ODOMETRY: 2}
    assert rejection_counts(statistics, 'r2') == {RejectionReason.BEFORE_ODOMETRY: 1}
    assert sequencer.waiting('r1') == sequencer.waiting('r2') == 0


def test_release_waits_for_no_robot():
    sequencer, statistics = sequencer_of('r1', 'r2', 'r3')

    steps = all_steps(sequencer, odometry('r1', 0), odometry('r2', 30), odometry('r1', 50))

    assert stamps(steps) == [0, 30, 50]
    assert not list(sequencer.release())
    later = fed(sequencer, odometry('r1', 60), odometry('r1', 161), odometry('r2', 161))
    assert stamps(later) == [60]
    assert statistics.rejected.total() == statistics.released_without.total() == 0


def test_records_after_a_release_are_used_if_they_are_in_order():
    sequencer, statistics = sequencer_of('r1')
    all_steps(sequencer, odometry('r1', 0), odometry('r1', 50))

    assert stamps(all_steps(sequencer, odometry('r1', 40), odometry('r1', 60))) == [60]
    assert rejection_counts(statistics) == {RejectionReason.LATE: 1}


@pytest.mark.parametrize('second', [scan('r1', 50, ANOTHER), scan('r1', 50)])
def test_two_different_scans_at_one_stamp_are_one_step(second):
    sequencer, statistics = sequencer_of('r1')

    steps = all_steps(
        sequencer, odometry('r1', 0), second, scan('r1', 50, A_LANDMARK), odometry('r1', 100))

    assert stamps(steps) == [0, 50, 100]
    (seen,) = steps[1].scans
    assert [s.id for s in seen.observations] == [1, *(s.id for s in second.observations)]
    assert statistics.rejected.total() == 0


def test_scans_of_one_stamp_that_are_too_large_together_do_not_depend_on_their_order():
    kept = set()
    for order in permutations(range(3)):
        sequencer, statistics = sequencer_of('r1', max_observations=10)
        parts = [scan('r1', 50, [(10 * k + i, (1.0, 0.0)) for i in range(6)]) for k in range(3)]
        steps = all_steps(
            sequencer, odometry('r1', 0), *(parts[k] for k in order), odometry('r1', 400))
        step = next(step for step in steps if step.scans)
        kept.add(tuple(observation.id for observation in step.scans[0].observations))
        assert rejection_counts(statistics) == {RejectionReason.TOO_LARGE: 2}
        assert not statistics.depends_on_arrival()
    assert len(kept) == 1
    assert len(*kept) == 6


def test_duplicates_are_counted_and_change_nothing():
    records = [odometry('r1', 0), scan('r1', 50, A_LANDMARK), odometry('r1', 100)]
    sequencer, statistics = sequencer_of('r1')

    steps = all_steps(sequencer, *records, *records)
    steps += all_steps(sequencer, *records)

    assert stamps(steps) == [0, 50, 100]
    assert len(steps[1].scans[0].observations) == 1
    assert rejection_counts(statistics) == {RejectionReason.DUPLICATE: 6}


def test_of_conflicting_odometry_the_first_is_used():
    sequencer, statistics = sequencer_of('r1')

    _, step = all_steps(
        sequencer, odometry('r1', 0), odometry('r1', 100, (1.0, 0.0, 0.0)),
        odometry('r1', 100, (9.0, 0.0, 0.0)))

    assert step.motions[0].u[0] == 1.0
    assert rejection_counts(statistics) == {RejectionReason.CONFLICTING: 1}
    assert statistics.depends_on_arrival()


@pytest.mark.parametrize('late', [odometry('r1', 50), scan('r1', 100, A_LANDMARK)])
def test_late_data_is_rejected_with_its_delay_behind_the_newest_odometry(late):
    sequencer, statistics = sequencer_of('r1')
    fed(sequencer, odometry('r1', 0), odometry('r1', 100), odometry('r1', 300))

    assert not fed(sequencer, late)

    (rejection,) = statistics.rejections
    delay = 300 * MS - late.stamp
    assert (rejection.robot, rejection.stamp) == ('r1', late.stamp)
    assert (rejection.reason, rejection.delay) == (RejectionReason.LATE, delay)
    assert statistics.longest_delay == {'r1': delay}
    assert statistics.depends_on_arrival()


def test_a_scan_that_arrives_when_its_stamp_is_passed_but_not_used_is_not_late():
    sequencer, statistics = sequencer_of('r1')

    steps = fed(
        sequencer, odometry('r1', 0), odometry('r1', 100), odometry('r1', 149), scan('r1', 50),
        odometry('r1', 201))

    assert stamps(steps) == [0, 50, 100]
    assert statistics.rejected.total() == 0


@pytest.mark.parametrize('of_r2', [(), (0, 80, 500)])
def test_odometry_within_max_delay_is_used_although_a_scan_divides_the_increment_around_it(of_r2):
    sequencer, statistics = sequencer_of('r1', *(['r2'] if of_r2 else []))

    steps = all_steps(
        sequencer, *(odometry('r2', ms) for ms in of_r2), odometry('r1', 0), scan('r1', 80),
        odometry('r1', 200), odometry('r1', 150), odometry('r1', 500))

    assert stamps(steps) == [0, 80, 150, 200, 500]
    assert statistics.rejected.total() == 0


def test_a_scan_older_than_all_odometry_is_rejected_as_before_odometry_whenever_it_arrives():
    sequencer, statistics = sequencer_of('r1')

    all_steps(sequencer, odometry('r1', 200), odometry('r1', 400), scan('r1', 150))

    assert rejection_counts(statistics) == {RejectionReason.BEFORE_ODOMETRY: 1}


def test_odometry_older_than_a_rejected_scan_is_late():
    sequencer, statistics = sequencer_of('r1')

    all_steps(
        sequencer, odometry('r1', 200), scan('r1', 150), odometry('r1', 301), odometry('r1', 100))

    assert rejection_counts(statistics) == {
        RejectionReason.BEFORE_ODOMETRY: 1, RejectionReason.LATE: 1}


def test_data_delayed_by_a_link_failure_are_used_in_their_own_order():
    sequencer, statistics = sequencer_of('r1', 'r2')
    outage = [r for ms in range(200, 3000, 200) for r in (odometry('r2', ms), scan('r2', ms))]
    fed(sequencer, *(odometry(name, ms) for name, ms in (
        ('r1', 0), ('r2', 0), ('r1', 5000), ('r1', 5200))))

    steps = fed(sequencer, *outage)

    # The last of them waits for delayed data, like that of a live robot.
    assert stamps_of('r2', steps) == list(range(200, 2800, 200))
    assert all(step.scans for step in steps)
    assert statistics.rejected.total() == 0
    assert statistics.released_without == {'r2': len(steps)}


def test_the_last_data_of_a_robot_that_fell_silent_do_not_wait_for_its_return():
    sequencer, _ = sequencer_of('r1', 'r2')

    steps = fed(
        sequencer, odometry('r1', 0), odometry('r2', 0), odometry('r2', 100), odometry('r1', 1101),
        odometry('r1', 2000))

    assert stamps_of('r2', steps) == [0, 100]


def random_arrivals(seed):
    """Return records of three robots with delays, silences and scans of each other."""
    rng, records = np.random.default_rng(seed), []
    for robot in ('r1', 'r2', 'r3'):
        begin, end = sorted(rng.integers(0, 6000, 2))
        sent = [
            ms for ms in range(0, 6000, int(rng.integers(30, 200))) if not begin < ms < end]
        records += [(ms + rng.exponential(60.0), odometry(robot, ms)) for ms in sent]
        for ms in rng.integers(0, 6000, 15).tolist():
            other = [(rng.choice([r for r in ('r1', 'r2', 'r3') if r != robot]), (1.0, 0.0))]
            observed = scan(robot, ms) if ms % 3 else robot_scan(robot, ms, other)
            records.append((ms + rng.exponential(60.0), observed))
    return [record for _, record in sorted(records, key=lambda arrived: arrived[0])]


@pytest.mark.parametrize('seed', range(40))
def test_steps_come_out_as_if_every_record_were_followed_by_a_question_to_all_robots(seed):
    (sequencer, _), (asking, _) = (sequencer_of('r1', 'r2', 'r3') for _ in range(2))
    for record in random_arrivals(seed):
        for receiver in (sequencer, asking):
            receiver.add(record, None)
        # After this it has to ask all robots.
        asking.resume()

        steps, expected = [*sequencer.take()], [*asking.take()]

        assert [(s.stamp, [*s.odometry], len(s.scans), len(s.robot_scans)) for s in steps] == [
            (s.stamp, [*s.odometry], len(s.scans), len(s.robot_scans)) for s in expected]


def test_a_duplicate_of_a_waiting_record_is_recognised_however_many_wait():
    sequencer, statistics = sequencer_of('r1')
    waiting = [odometry('r1', ms) for ms in range(MAX_REMEMBERED + FORGOTTEN_TOGETHER)]
    for record in waiting:
        sequencer.add(record, None)

    sequencer.add(waiting[0], None)

    assert rejection_counts(statistics) == {RejectionReason.DUPLICATE: 1}


def test_of_too_many_scans_without_odometry_the_oldest_are_rejected():
    sequencer, statistics = sequencer_of('r1', 'r2')

    for ms in range(MAX_QUEUED_SCANS + 3):
        sequencer.add(scan('r2', ms), None)

    assert sequencer.waiting('r2') == MAX_QUEUED_SCANS
    assert [rejection.stamp for rejection in statistics.rejections] == [0, MS, 2 * MS]
    assert rejection_counts(statistics, 'r2') == {RejectionReason.BEFORE_ODOMETRY: 3}


def test_a_stamp_more_than_future_limit_ahead_of_its_reception_is_rejected():
    sequencer, statistics = sequencer_of('r1')

    sequencer.add(odometry('r1', 5000), received=0)
    sequencer.add(odometry('r1', 5000 + A_NANOSECOND), received=0)
    sequencer.add(scan('r1', 9000), received=3999 * MS)
    sequencer.add(odometry('r1', 9000), received=None)

    assert stamps(sequencer.release()) == [5000, 9000]
    assert rejection_counts(statistics) == {RejectionReason.FUTURE: 2}


def test_records_of_a_robot_outside_the_team_are_rejected():
    sequencer, statistics = sequencer_of('r1')

    assert stamps(all_steps(sequencer, odometry('r9', 0), scan('r9', 0), odometry('r1', 0))) == [0]
    assert rejection_counts(statistics, 'r9') == {RejectionReason.UNKNOWN_ROBOT: 2}
    assert sequencer.waiting('r9') == 0


def test_a_long_sequencer_keeps_few_records_waiting():
    sequencer, statistics = sequencer_of('r1', 'r2')
    most, steps = 0, 0
    for ms in range(0, 200_000, 20):
        steps += len(fed(
            sequencer, odometry('r1', ms), scan('r1', ms + 7), odometry('r2', ms + 3),
            scan('r2', ms + 11)))
        most = max(most, sequencer.waiting('r1') + sequencer.waiting('r2'))

    # Events of the last max_delay and of the increment that a scan divides there, 6 periods of 4
    # records, and those of the present period.
    assert most <= 28
    assert steps >= 40_000 - 28
    assert statistics.rejected.total() == 0


@pytest.mark.parametrize('latency', [0, 50, 90])
def test_data_of_a_robot_that_falls_silent_have_the_same_order_at_any_latency(latency):
    sequencer, statistics = sequencer_of('r1', 'r2')
    arrivals = [(ms, odometry('r1', ms)) for ms in range(0, 5000, 20)]
    arrivals += [(ms + latency, odometry('r2', ms)) for ms in range(0, 2001, 100)]

    steps = all_steps(sequencer, *(record for _, record in sorted(arrivals, key=lambda a: a[0])))

    assert stamps(steps) == list(range(0, 5000, 20))
    assert not statistics.depends_on_arrival()


def test_waiting_scans_that_the_processor_cannot_keep_up_with_are_rejected_but_the_newest():
    sequencer, statistics = sequencer_of('r1', 'r2')
    large = [(number, (1.0, 0.0)) for number in range(9)]
    for ms in (0, 100, 200, 300):
        sequencer.add(odometry('r1', ms), None)
        sequencer.add(odometry('r2', ms), None)
        sequencer.add(scan('r1', ms, large), None)
        sequencer.add(scan('r2', ms, large[:3]), None)

    sequencer.shed(size=5, most=10, rate=100.0)

    assert [s.stamp // MS for step in sequencer.release() for s in step.scans
            if s.robot == 'r1'] == [300]
    assert rejection_counts(statistics) == {RejectionReason.OVERLOAD: 3}
    assert rejection_counts(statistics, 'r2') == {}
    assert statistics.depends_on_arrival()


def test_when_the_process_ends_the_waiting_records_are_rejected():
    sequencer, statistics = sequencer_of('r1')
    for ms in range(0, 500, 100):
        sequencer.add(odometry('r1', ms), None)
    ends = iter([False, False, True])

    with between_pieces(lambda: None, lambda: next(ends)):
        steps = list(sequencer.release())

    assert stamps(steps) == [0, 100]
    assert rejection_counts(statistics) == {RejectionReason.INTERRUPTED: 3}
    assert sequencer.waiting('r1') == 0


def test_of_a_flood_of_scans_the_oldest_are_rejected_and_of_a_long_backlog_none():
    """Robot 1 sends a scan every 5 ms; those of robot 2, every 100 ms, have waited for long."""
    sequencer, statistics = sequencer_of('r1', 'r2')
    for ms in (0, 1000):
        for robot in 'r1', 'r2':
            sequencer.add(odometry(robot, ms), None)
    for k in range(5):
        sequencer.add(scan('r1', 900 + 5 * k), None)
        sequencer.add(scan('r2', 100 * (k + 1)), None)

    sequencer.shed(size=5, most=3, rate=100.0)

    kept = [(s.robot, s.stamp // MS) for step in sequencer.release() for s in step.scans]
    assert sorted(kept) == [
        *(('r1', ms) for ms in (910, 915, 920)), *(('r2', 100 * (k + 1)) for k in range(5))]
    assert rejection_counts(statistics) == {RejectionReason.OVERLOAD: 2}


def test_a_robot_ahead_of_the_others_that_leaves_makes_none_of_them_count_as_silent():
    sequencer, statistics = sequencer_of('r1', 'r2', 'r3')
    fed(sequencer, odometry('r3', 500_000))

    sequencer.change_team(team('r1', 'r2').robots)
    for ms in range(0, 3000, 100):
        # r2 is a little late, but within max_delay.
        fed(sequencer, odometry('r1', ms), *([odometry('r2', ms - 50)] if ms else []))
        assert all(not step.arrivals or ms < 200 for step in sequencer.take())

    assert statistics.released_without.total() == 0


def test_a_waiting_observation_of_a_robot_that_leaves_is_rejected_with_its_name():
    sequencer, statistics = sequencer_of('r1', 'r2')
    fed(sequencer, odometry('r1', 0), odometry('r2', 0), robot_scan('r1', 50, [('r2', (1, 0))]))

    sequencer.change_team(team('r1').robots)
    steps = all_steps(sequencer, odometry('r1', 100))

    assert [[len(found.observations) for found in step.robot_scans] for step in steps] == [
        [], [0], []]
    assert [(r.reason, r.observed) for r in statistics.rejections if r.robot == 'r1'] == [
        (RejectionReason.OTHER_ROBOT_STALE, 'r2')]


def test_a_scan_is_released_when_other_robots_have_passed_it_by_more_than_max_delay():
    sequencer, _ = sequencer_of('r1', 'r2')
    fed(sequencer, odometry('r1', 0), odometry('r2', 0), scan('r1', 50))

    assert stamps(fed(
        sequencer, odometry('r1', 100), odometry('r1', 400), odometry('r2', 150))) == [0]
    assert stamps(fed(sequencer, odometry('r2', 150 + A_NANOSECOND))) == [50]


def test_a_scan_before_the_step_that_another_robot_delays_does_not_wait_for_it():
    sequencer, _ = sequencer_of('r1', 'r2')
    fed(sequencer, odometry('r1', 0), odometry('r2', 0))
    # r2 delays the step at 200 ms, and has passed 120 ms by more than max_delay.
    fed(sequencer, *(odometry('r1', ms) for ms in (200, 400, 600)), odometry('r2', 290))

    assert stamps(fed(sequencer, scan('r1', 120))) == [120]


def test_late_data_of_a_stale_robot_wait_for_more_of_it_for_stale_after():
    sequencer, _ = sequencer_of('r1', 'r2')
    fed(sequencer, odometry('r1', 0), odometry('r2', 0), odometry('r1', 3000))

    held = fed(sequencer, odometry('r2', 200), odometry('r1', 4000))

    assert 200 not in stamps(held)
    assert 200 in stamps(fed(sequencer, odometry('r1', 4000 + A_NANOSECOND)))
