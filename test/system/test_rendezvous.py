# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robot observations are one step of both robots or rejected; max_delay 100 ms, stale 1 s."""

from itertools import permutations

import numpy as np
import pytest

from fej_slam_ros.core.ordering.robot_queue import MAX_QUEUED_SCANS
from fej_slam_ros.core.records import fingerprint, Odometry, RobotScan
from fej_slam_ros.core.rejections import RejectionReason
from helpers.optional import given, Phase, settings, strategies as st
from helpers.records import (
    A_NANOSECOND, all_steps, fed, MS, odometry, robot_scan, scan, sequencer_of, team)

R2, R3, R9 = [('r2', (3.0, 1.0))], [('r3', (4.0, 1.0))], [('r9', (9.0, 9.0))]
R1 = [('r1', (-3.0, -1.0))]


def every(ms, *robots, until=1000, since=0):
    """Return odometry of some robots, with a period in ms."""
    return [odometry(robot, t) for t in range(since, until + 1, ms) for robot in robots]


def who_was_where(steps):
    return {step.stamp / MS: [*step.odometry] for step in steps}


def meetings(steps):
    """Return stamp [ms], observer and observed robots of each robot scan."""
    return [
        (step.stamp / MS, seen_by.robot, [s.observed for s in seen_by.observations])
        for step in steps for seen_by in step.robot_scans]


def stale(statistics):
    """Return observer, stamp [ms] and ID of observations rejected as `other_robot_stale`."""
    return [
        (rejection.robot, rejection.stamp / MS, rejection.id)
        for rejection in statistics.rejections
        if rejection.reason is RejectionReason.OTHER_ROBOT_STALE]


def test_only_observer_and_observed_take_part_in_the_step_of_a_robot_observation():
    stream, statistics = sequencer_of('r1', 'r2', 'r3')

    steps = all_steps(stream, *every(100, 'r1', 'r2', 'r3', until=200), robot_scan('r1', 130, R2))

    assert who_was_where(steps)[130] == ['r1', 'r2']
    assert meetings(steps) == [(130, 'r1', ['r2'])]
    assert [motion.robot for motion in steps[2].motions] == ['r1', 'r2']
    assert statistics.rejected.total() == 0


def test_the_increment_of_the_observed_robot_is_divided_by_time():
    # At the time a, r2 has turned by a pi and what is left of u = (4, 0, pi) is seen from there.
    stream, _ = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, robot_scan('r1', 250, R2), *every(100, 'r1'),
        odometry('r2', 0, (0.0, 0.0, 0.0)), odometry('r2', 1000, (4.0, 0.0, np.pi)))

    motions = {m.stamp // MS: m.u for step in steps for m in step.motions if m.robot == 'r2'}
    c = np.sqrt(0.5)
    # The rounding of a few products of numbers up to 4.
    np.testing.assert_allclose(motions[250], [1.0, 0.0, np.pi / 4], atol=1e-14)
    np.testing.assert_allclose(motions[1000], [3 * c, -3 * c, 3 * np.pi / 4], atol=1e-14)
    at_250 = next(step for step in steps if step.stamp == 250 * MS)
    np.testing.assert_allclose(at_250.odometry['r2'], [1.0, 0.0, np.pi / 4], atol=1e-14)


def test_at_an_odometry_stamp_of_the_observed_robot_no_increment_is_divided():
    stream, _ = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, *every(60, 'r1', until=240), *every(50, 'r2', until=200),
        robot_scan('r1', 100, R2))

    assert [ms for ms, robots in who_was_where(steps).items() if 'r2' in robots] == [
        0, 50, 100, 150, 200]
    assert meetings(steps) == [(100, 'r1', ['r2'])]


def test_two_robots_may_observe_each_other_at_one_stamp():
    stream, _ = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, *every(100, 'r1', 'r2', until=200), robot_scan('r2', 130, R1),
        robot_scan('r1', 130, R2))

    assert meetings(steps) == [(130, 'r1', ['r2']), (130, 'r2', ['r1'])]


def test_robot_scans_at_one_stamp_are_merged_in_the_order_of_names():
    both_ways = permutations([
        robot_scan('r1', 50, R3 + R2), robot_scan('r1', 50, [('r2', (1.0, 9.0))])])

    for scans in both_ways:
        stream, _ = sequencer_of('r1', 'r2', 'r3')
        steps = all_steps(stream, *every(100, 'r1', 'r2', 'r3', until=100), *scans)
        (seen,) = steps[1].robot_scans
        assert [(s.observed, *s.z) for s in seen.observations] == [
            ('r2', 1.0, 9.0), ('r2', 3.0, 1.0), ('r3', 4.0, 1.0)]


def test_landmarks_and_robots_observed_at_one_stamp_are_one_step():
    stream, _ = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, *every(100, 'r1', 'r2', until=100), robot_scan('r1', 50, R2),
        scan('r1', 50, [(7, (2.0, 0.0))]), scan('r2', 50))

    assert [[s.robot for s in step.scans] for step in steps] == [[], ['r1', 'r2'], []]
    assert meetings(steps) == [(50, 'r1', ['r2'])]


def test_a_robot_scan_without_robots_is_a_step_of_its_observer_alone():
    stream, _ = sequencer_of('r1', 'r2')

    steps = all_steps(stream, *every(100, 'r1', 'r2', until=100), robot_scan('r1', 50))

    assert who_was_where(steps)[50] == ['r1']


def test_a_robot_observation_waits_for_odometry_inside_the_increment_of_the_observed_robot():
    stream, _ = sequencer_of('r1', 'r2')

    held = fed(
        stream, odometry('r1', 0), odometry('r2', 0), robot_scan('r1', 50, R2),
        *every(50, 'r1', since=50, until=600), odometry('r2', 200), odometry('r2', 300))
    released = fed(stream, odometry('r2', 300 + A_NANOSECOND))

    assert [step.stamp for step in held] == [0]
    assert [step.stamp // MS for step in released] == [50, 100, 150, 200]


def test_an_observed_robot_advanced_while_the_observer_was_stale_is_rejected_and_counted():
    stream, statistics = sequencer_of('r1', 'r2')
    fed(stream, odometry('r1', 0), *every(100, 'r2', until=3000))

    steps = all_steps(stream, odometry('r1', 1000), robot_scan('r1', 950, R2))

    assert meetings(steps) == [(950, 'r1', [])]
    assert who_was_where(steps)[950] == ['r1']
    assert stale(statistics) == [('r1', 950, 2)]
    assert statistics.released_without['r1'] > 0


def test_only_observed_robots_without_odometry_at_the_stamp_are_rejected_from_a_scan():
    stream, statistics = sequencer_of('r1', 'r2', 'r3')

    steps = all_steps(
        stream, *every(100, 'r1', 'r3'), *every(100, 'r2', until=400),
        robot_scan('r1', 950, R2 + R3))

    assert meetings(steps) == [(950, 'r1', ['r3'])]
    assert stale(statistics) == [('r1', 950, 2)]
    assert statistics.rejected.total() == 0


@pytest.mark.parametrize('comes', [500, 560])
def test_odometry_that_arrives_after_the_step_it_belongs_to_is_counted(comes):
    stream, statistics = sequencer_of('r1', 'r2')
    all_steps(
        stream, *every(100, 'r1', until=500), *every(100, 'r2', until=400),
        robot_scan('r1', 450, R2))

    all_steps(stream, odometry('r2', comes))

    assert statistics.released_without == {'r2': 1}
    assert statistics.depends_on_arrival()


def test_an_observed_robot_without_earlier_odometry_is_rejected_in_any_order_of_arrival():
    of_r1 = [robot_scan('r1', 50, R2), *every(100, 'r1', until=300)]
    of_r2 = every(100, 'r2', since=60, until=260)

    for arrived in (of_r1 + of_r2, of_r2 + of_r1):
        stream, statistics = sequencer_of('r1', 'r2')
        steps = all_steps(stream, *arrived)
        assert (meetings(steps), stale(statistics)) == ([(50, 'r1', [])], [('r1', 50, 2)])
        assert not statistics.depends_on_arrival()


def test_a_robot_may_be_observed_at_its_first_odometry():
    stream, _ = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, robot_scan('r1', 50, R2), *every(100, 'r1', until=300),
        *every(100, 'r2', since=50, until=250))

    assert steps[1].arrivals == ('r2',)
    assert meetings(steps) == [(50, 'r1', ['r2'])]


@pytest.mark.parametrize(('back_at', 'seen'), [(1000, ['r2']), (1001, [])])
def test_a_robot_is_not_observed_within_an_odometry_gap_beyond_the_waiting_time(back_at, seen):
    stream, statistics = sequencer_of('r1', 'r2')
    arriving = sorted(
        [*every(100, 'r1', until=2000), odometry('r2', 0), *every(100, 'r2', since=back_at),
         odometry('r2', back_at), odometry('r2', 2000), robot_scan('r1', 450, R2)],
        key=lambda record: record.stamp)

    steps = all_steps(stream, *arriving)

    assert meetings(steps) == [(450, 'r1', seen)]
    assert not statistics.depends_on_arrival()


def test_a_robot_whose_link_has_returned_is_observed_only_after_its_odometry_is_in_order():
    stream, statistics = sequencer_of('r1', 'r2')
    fed(stream, odometry('r1', 0), odometry('r2', 0), *every(100, 'r1', since=100, until=3000))

    fed(stream, robot_scan('r1', 2950, R2), *every(100, 'r2', since=100, until=3000))
    steps = fed(stream, *every(100, 'r1', since=3100, until=3200))

    assert meetings(steps) == []
    assert meetings(all_steps(stream, *every(100, 'r2', since=3100, until=3200))) == [
        (2950, 'r1', ['r2'])]
    assert stale(statistics) == []


@pytest.mark.parametrize('at_once', [False, True])
def test_a_scan_before_the_odometry_of_its_observer_advances_no_robot(at_once):
    early, odometry_of_r1 = robot_scan('r1', 150, R2), every(100, 'r1', since=200, until=400)
    stream, statistics = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, *every(100, 'r2', until=400),
        *([*odometry_of_r1, early] if at_once else [early, *odometry_of_r1]))

    assert 150 not in who_was_where(steps)
    assert statistics.rejection_counts['r1'] == {RejectionReason.BEFORE_ODOMETRY: 1}


def test_an_observation_before_the_first_odometry_of_the_observed_robot_is_rejected():
    stream, statistics = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, *every(100, 'r1', until=300), robot_scan('r1', 50, R2), robot_scan('r2', 50, R1),
        *every(100, 'r2', since=100, until=300))

    assert meetings(steps) == [(50, 'r1', [])]
    assert statistics.rejection_counts['r2'] == {RejectionReason.BEFORE_ODOMETRY: 1}
    assert stale(statistics) == [('r1', 50, 2)]


def test_a_robot_scan_waits_for_odometry_of_its_observer_until_the_input_ends():
    stream, statistics = sequencer_of('r1', 'r2')

    steps = all_steps(
        stream, *every(100, 'r1', until=200), *every(100, 'r2', until=400),
        robot_scan('r1', 250, R2))
    waiting = stream.waiting('r1')
    stream.close()

    assert 250 not in who_was_where(steps)
    assert (waiting, stream.waiting('r1')) == (1, 0)
    assert statistics.rejection_counts['r1'] == {RejectionReason.AFTER_ODOMETRY: 1}


def test_late_and_duplicate_robot_scans_are_rejected():
    stream, statistics = sequencer_of('r1', 'r2')
    records = [*every(100, 'r1', 'r2', until=300), robot_scan('r1', 150, R2)]

    all_steps(stream, *records, records[-1])
    all_steps(stream, records[-1], robot_scan('r1', 150, R1), robot_scan('r1', 160, R2))

    assert statistics.rejection_counts['r1'] == {
        RejectionReason.DUPLICATE: 2, RejectionReason.LATE: 2}


def test_robot_scans_without_odometry_are_rejected_oldest_first():
    stream, statistics = sequencer_of('r1', 'r2')

    for ms in range(MAX_QUEUED_SCANS + 2):
        stream.add(robot_scan('r1', ms, R2), None)

    assert stream.waiting('r1') == MAX_QUEUED_SCANS
    assert [rejection.stamp for rejection in statistics.rejections] == [0, MS]


def test_observations_of_robots_outside_the_team_are_rejected():
    stream, statistics = sequencer_of('r1', 'r2', 'r3')
    fed(
        stream, *every(100, 'r1', 'r2', 'r3', until=200),
        robot_scan('r1', 150, [*R2, *R3, *R9]))

    stream.change_team(team('r1', 'r2').robots)
    steps = all_steps(stream)

    assert meetings(steps) == [(150, 'r1', ['r2'])]
    assert stale(statistics) == [('r1', 150, 3), ('r1', 150, -1)]


def test_observations_by_a_removed_robot_advance_no_robot():
    stream, statistics = sequencer_of('r1', 'r2')
    fed(stream, *every(100, 'r1', 'r2', until=200), robot_scan('r1', 150, R2))

    stream.change_team(team('r2').robots)

    assert 150 not in who_was_where(all_steps(stream))
    # The observation, and odometry of 100 and 200 ms.
    assert statistics.rejection_counts['r1'] == {RejectionReason.LEFT: 3}


def test_a_long_stream_of_robot_observations_keeps_few_records_waiting():
    stream, statistics = sequencer_of('r1', 'r2')
    most, met = 0, 0
    for ms in range(0, 60_000, 20):
        met += len(meetings(fed(
            stream, odometry('r1', ms), robot_scan('r1', ms + 7, R2), odometry('r2', ms + 3),
            robot_scan('r2', ms + 11, R1))))
        most = max(most, stream.waiting('r1') + stream.waiting('r2'))

    # Events of the last max_delay and of the increments divided there, and the present period.
    assert most <= 28
    assert met >= 6_000 - 14
    assert statistics.rejection_counts == {}


TEAM = 'r1', 'r2', 'r3'
PAIRS = [*permutations(TEAM, 2)]
PERIODS = {'r1': 50, 'r2': 67, 'r3': 40}
END = 1500
#: Who lags is waited for: stale_after is longer than lag, delay and period of odometry together.
STALE_AFTER, MAX_DELAY, LAG = 0.6, 100, 400


def is_silent(record, silence):
    """Return whether r3 is silent for so long; between two odometry stamps it sees nothing."""
    around = 0 if isinstance(record, Odometry) else PERIODS['r3']
    began = 300 * MS
    return record.robot == 'r3' and silence > 0 and (
        began - around * MS < record.stamp < began + (silence + around) * MS)


@st.composite
def arrivals(draw):
    """Draw the records of three robots in order of stamps, and the same as they arrive."""
    records = [
        record for robot, period in PERIODS.items()
        for record in every(period, robot, since=draw(st.integers(0, 100)), until=END)]
    times = st.integers(0, END)
    observations = st.lists(st.tuples(times, st.sampled_from(PAIRS)), max_size=40)
    for ms, (observer, seen) in draw(observations):
        records.append(robot_scan(observer, ms, [(seen, (ms / 100.0, 1.0))]))
    for ms, robot in draw(st.lists(st.tuples(times, st.sampled_from(TEAM)), max_size=10)):
        # Another landmark each time, so that nothing is a duplicate.
        records.append(scan(robot, ms, [(len(records), (1.0, 1.0))]))
    # One robot is silent for less or more than stale_after, by little or by much, or for good.
    silence = draw(st.sampled_from([0, 160, 590, 640, 800, END]))
    records = draw(st.permutations([r for r in records if not is_silent(r, silence)]))
    delays = draw(st.lists(
        st.integers(0, MAX_DELAY - 1), min_size=len(records), max_size=len(records)))
    lag = {'r1': 0, 'r2': draw(st.sampled_from([0, LAG])), 'r3': 0}
    arrived = sorted(
        zip(records, delays), key=lambda sent: sent[0].stamp // MS + sent[1] + lag[sent[0].robot])
    return sorted(records, key=lambda r: r.stamp), [record for record, _ in arrived]


def bits(steps):
    """Return all that is in some steps."""
    return [
        (step.stamp, step.arrivals,
         [(m.robot, m.u.tobytes(), m.Q.tobytes()) for m in step.motions],
         [(s.robot, fingerprint(s)) for s in (*step.scans, *step.robot_scans)],
         {robot: pose.tobytes() for robot, pose in step.odometry.items()})
        for step in steps]


def run(records):
    stream, statistics = sequencer_of(*TEAM, stale_after=STALE_AFTER)
    return all_steps(stream, *records), statistics


def assert_each_meeting_is_one(records, steps, statistics):
    """Each observation of a scan that was used is of two robots that are there, or is refused."""
    met = {
        (step.stamp / MS, seen_by.robot, s.observed):
            {seen_by.robot, s.observed} <= step.odometry.keys()
        for step in steps for seen_by in step.robot_scans for s in seen_by.observations}
    scans = {(r.stamp / MS, r.robot) for r in records if isinstance(r, RobotScan)}
    used = {(step.stamp / MS, r.robot) for step in steps for r in step.robot_scans}
    assert all(met.values())
    assert used <= scans
    observations = {
        (r.stamp / MS, r.robot, s.observed) for r in records if isinstance(r, RobotScan)
        for s in r.observations if (r.stamp / MS, r.robot) in used}
    rejected = {(ms, robot, f'r{number}') for robot, ms, number in stale(statistics)}
    assert observations == met.keys() | rejected
    assert not met.keys() & rejected


def assert_same_bits_in_any_order(arrival):
    in_order, arrived = arrival

    expected, (steps, statistics) = run(in_order), run(arrived)

    assert bits(steps) == bits(expected[0])
    assert sorted(stale(statistics)) == sorted(stale(expected[1]))
    assert not statistics.depends_on_arrival()
    assert_each_meeting_is_one(arrived, steps, statistics)
    for step in steps:
        for pose in step.odometry.values():
            # All drive at 1 m/s; some increments of 0.1 m are divided a few times.
            np.testing.assert_allclose(pose, [step.stamp / (1000 * MS), 0.0, 0.0], atol=1e-12)


#: To shrink a failing run of 100 records takes longer than a test may.
PHASES = [Phase.explicit, Phase.reuse, Phase.generate]


@settings(max_examples=100, deadline=None, phases=PHASES, derandomize=True)
@given(arrivals())
def test_input_within_max_delay_gives_the_same_steps_in_any_order_of_arrival(arrival):
    assert_same_bits_in_any_order(arrival)


@pytest.mark.slow
@settings(max_examples=2000, deadline=None, phases=PHASES)
@given(arrivals())
def test_two_thousand_orders_of_arrival_give_the_same_steps(arrival):
    assert_same_bits_in_any_order(arrival)
