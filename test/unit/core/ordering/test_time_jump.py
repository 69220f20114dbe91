# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two passes through the same time never mix in an estimate; max_delay 100 ms, stale 1 s."""

from dataclasses import replace

import numpy as np
import pytest

from fej_slam_ros.core.ordering import time_jump
from fej_slam_ros.core.ordering.time_jump import (
    BackwardOdometry, MAX_WAIT_FOR_OTHERS, MIN_RETURN_RECORDS)
from fej_slam_ros.core.records import NS, PosePrior
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.session import simulation
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.records import MS, odometry, scan
from helpers.ros import (
    feed, meeting, meeting_truth, odometry_message, raw, raw_record, run_settings, run_verb,
    summary_of, write_bag, write_parameters)

#: Both robots, odometry and scans every 100 ms for 4 s.
PASS = [raw_record(record) for record in meeting(41)]
TRUTH = [raw_record(record) for record in meeting_truth(41)]
#: Number of messages of a second pass by which it is detected.
DETECTED = 2 + 4 * (MIN_RETURN_RECORDS - 1) - 1


def later(messages, seconds=10.0):
    """Return messages with the same stamps, received later."""
    return [replace(m, received=m.received + round(seconds * NS)) for m in messages]


def runs_of(messages, *names, **options):
    """Return the runs that messages give, all of them closed."""
    runs = [EstimatorSession(run_settings(*names, **options), None)]
    for message in messages:
        runs[-1].receive(message)
        list(runs[-1].take())
        if runs[-1].inputs.time_jump_detector.has_ended_run():
            list(runs[-1].close())
            runs.append(EstimatorSession(run_settings(*names, **options), None))
            runs[-1].continue_from(runs[-2])
    list(runs[-1].close())
    return runs


def hashes(runs):
    return [run.estimator.state_hash() for run in runs]


def counts(run):
    """Return the number of rejections by reason."""
    return {r.value: n for r in RejectionReason if (n := run.estimator.statistics.total(r))}


ONE_PASS, = runs_of(PASS)
HASH = ONE_PASS.estimator.state_hash()


def test_input_after_a_jump_is_rejected_and_changes_no_bit():
    run, = runs_of([*PASS, *later(PASS)])

    assert hashes([run]) == [HASH]
    assert counts(run) == {'after_time_jump': len(PASS)}
    assert run.inputs.time_jump_detector.jump.length == 4000 * MS
    assert not run.estimator.statistics.depends_on_arrival()


def test_a_reset_starts_a_new_run_with_the_first_message_of_the_second_pass():
    runs = runs_of([*PASS, *later(PASS), *later(PASS, 20.0)], on_time_jump='reset')

    assert hashes(runs) == [HASH] * 3
    assert [counts(run) for run in runs] == [{}] * 3
    assert [run.estimator.used('r1') for run in runs] == [ONE_PASS.estimator.used('r1')] * 3


def test_what_is_received_before_the_new_run_begins_is_used_by_it():
    earlier, following = (
        EstimatorSession(run_settings(on_time_jump='reset'), None) for _ in range(2))
    second = later(PASS)
    for message in [*PASS, *second[:DETECTED + 8]]:
        earlier.receive(message)
    list(earlier.close())

    following.continue_from(earlier)
    for message in second[DETECTED + 8:]:
        following.receive(message)
    list(following.close())

    assert hashes([earlier, following]) == [HASH] * 2
    assert [counts(run) for run in (earlier, following)] == [{}] * 2


def test_a_pose_that_is_given_for_an_earlier_time_than_the_last_one_is_no_jump():
    run = EstimatorSession(run_settings(), None)
    given = [PosePrior('r1', stamp * MS, np.zeros(3), np.eye(3)) for stamp in (3900, 0)]
    for message in [*PASS, *map(raw_record, given)]:
        run.receive(message)

    assert run.inputs.health.pose_priors == {'r1': [3900 * MS, 0]}


def test_a_second_pass_longer_than_the_first_is_not_mixed_with_it():
    first = [m for m in PASS if m.received <= 3000 * MS]

    rejected, = runs_of([*first, *later(PASS)])
    ended, begun = runs_of([*first, *later(PASS)], on_time_jump='reset')

    assert hashes([rejected]) == hashes([ended]) == hashes(runs_of(first))
    assert hashes([begun]) == [HASH]


@pytest.mark.parametrize('sends_first', [False, True])
def test_a_second_pass_with_a_new_robot_is_not_mixed_with_the_first(sends_first):
    team = ('r1', 'r2', 'r3')
    first = [m for m in PASS if m.received <= 3000 * MS]
    second = sorted(
        [*PASS, *(raw_record(odometry('r3', 100 * k, (0.0, 0.0, 0.0))) for k in range(41))],
        key=lambda m: (m.received, m.topic.startswith('r3') != sends_first))

    ended, begun = runs_of([*first, *later(second)], *team, on_time_jump='reset')

    expected, = runs_of(first, *team)
    for name in 'r1', 'r2':
        assert ended.estimator.used(name) == expected.estimator.used(name)
    # What it sent before the others have gone back is of the first.
    assert hashes([begun]) == hashes(runs_of(second[sends_first:], *team))


def test_a_jump_of_the_clock_of_reception_has_no_effect():
    rejected, = runs_of([*PASS, *PASS])

    assert hashes([rejected]) == [HASH]
    assert hashes(runs_of([*PASS, *PASS], on_time_jump='reset')) == [HASH, HASH]


def test_the_next_run_keeps_the_ground_truth_map():
    _, run = runs_of([*TRUTH, *PASS, *later(PASS)], on_time_jump='reset')

    assert set(run.estimator.truth.landmarks) == {1, 2, 3}


def messages_of(robot, messages):
    return [message for message in messages if message.topic.startswith(robot)]


@pytest.mark.parametrize('option', ['refuse', 'reset'])
@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_data_of_a_single_robot_that_jumps_back_are_late_and_the_others_continue(robot, option):
    """Its clock jumps by 2.5 s, or its driver starts again with old stamps."""
    first, rest = PASS[:120], PASS[120:]
    again = messages_of(robot, PASS)[10:]
    mixed = [
        m for pair in zip(rest, later(again, 0.0)) for m in pair
        if m not in messages_of(robot, rest)]
    expected, = runs_of([*first, *(m for m in rest if m not in messages_of(robot, rest))])

    run, = runs_of([*first, *mixed], on_time_jump=option)

    assert run.inputs.time_jump_detector.jump is None
    assert hashes([run]) == hashes([expected])
    assert counts(run)['duplicate'] > 0


@pytest.mark.parametrize('option', ['refuse', 'reset'])
def test_data_delayed_by_a_link_failure_are_no_jump(option):
    """All of r2's odometry comes 3 s late, then all of its scans, which are behind it."""
    held_back = [m for m in messages_of('r2', PASS) if m.received > 500 * MS]
    odometry = [m for m in held_back if m.topic.endswith('odom')]
    scans = [m for m in held_back if not m.topic.endswith('odom')]
    in_time = [m for m in PASS if m not in held_back]

    run = EstimatorSession(run_settings(on_time_jump=option), None)
    for message in [*in_time, *odometry, *scans]:
        run.receive(message)
    list(run.close())

    assert run.inputs.time_jump_detector.jump is None
    assert counts(run) == {}
    assert run.estimator.steps == {'r1': 41, 'r2': 41}


def test_few_old_messages_of_all_robots_are_late_and_no_jump():
    old, more = PASS[:DETECTED - 1], PASS[DETECTED - 1:2 * DETECTED - 2]

    run, = runs_of(
        [*PASS[:-8], *old, *PASS[-8:-4], *more, *PASS[-4:]], on_time_jump='reset')

    assert hashes([run]) == [HASH]
    assert counts(run) == {'duplicate': len(old) + len(more)}


@pytest.mark.parametrize('stamps', [
    # As close as no odometry is, and as far apart as none that is waited for.
    range(1, 6), [1 + k + 1500 * MS * (k % 2) for k in range(6)]])
def test_stray_stamps_of_all_robots_are_no_jump(stamps):
    last = PASS[-1].received
    stray = [
        raw(f'{robot}/odom', odometry_message(stamp / MS, (9.0, 0.0, 0.0)), last / MS)
        for stamp in stamps for robot in ('r1', 'r2')]
    by_now = [m for m in PASS if m.received < last]

    run, = runs_of([*by_now, *stray, *PASS[len(by_now):]])

    assert hashes([run]) == [HASH]
    assert run.inputs.time_jump_detector.jump is None
    assert sum(counts(run).values()) == len(stray)


def test_the_jump_of_a_single_robot_is_certain_when_others_have_continued():
    ahead = [raw_record(odometry('r2', ms)) for ms in range(4100, 5300, 100)]
    run = EstimatorSession(run_settings(), None)

    rejected = []
    for message in [*PASS, *messages_of('r1', PASS)[:20], *ahead]:
        run.receive(message)
        rejected.append(counts(run))

    # The limit is 1.1 s.
    assert rejected[-3:] == [{}, {}, {'duplicate': 20}]
    assert run.inputs.time_jump_detector.jump is None


def test_a_jump_of_all_robots_is_detected_after_that_of_a_single_robot():
    ahead = [raw_record(odometry('r2', ms)) for ms in range(4100, 5300, 100)]
    alone = messages_of('r1', PASS)

    _, run = runs_of(
        [*PASS, *alone[2:20], *ahead, *alone[20:40], *PASS], on_time_jump='reset')

    assert hashes([run]) == [HASH]
    assert counts(run) == {}


def test_old_messages_at_the_end_of_the_input_are_late_and_no_jump():
    run, = runs_of([*PASS, *PASS[:DETECTED - 1]])

    assert counts(run) == {'duplicate': DETECTED - 1}
    assert run.estimator.used('r1') == ONE_PASS.estimator.used('r1')


def test_a_jump_needs_all_robots_that_sent_odometry():
    without_r2 = messages_of('r1', PASS)

    run, = runs_of([*PASS, *later(without_r2)], on_time_jump='reset')

    assert run.inputs.time_jump_detector.jump is None
    assert counts(run) == {'duplicate': len(without_r2)}


def test_a_jump_does_not_wait_forever_for_a_silent_robot():
    end = MAX_WAIT_FOR_OTHERS // MS + 300
    alone = [raw_record(odometry('r1', ms)) for ms in range(0, end, 100)]
    until_20_s = [raw_record(odometry(name, ms)) for ms in range(0, 20_000, 100)
                  for name in ('r1', 'r2')]

    runs = runs_of([*until_20_s, *alone], on_time_jump='reset')

    assert [run.estimator.steps['r1'] for run in runs] == [200, len(alone)]
    assert [run.estimator.steps['r2'] for run in runs] == [200, 0]


def test_late_messages_of_the_first_pass_are_rejected_in_the_second():
    """A scan comes after the jump, and odometry would reach it in the end."""
    left_over = raw_record(scan('r1', 3950, [(9, (1.0, 0.0))]))
    odometry_only = [m for m in PASS if m.topic.endswith('odom')]

    _, run = runs_of(
        [PASS[3], *odometry_only, *odometry_only[:20], left_over, *odometry_only[20:]],
        on_time_jump='reset')

    assert counts(run) == {'before_time_jump': 1}
    assert run.estimator.statistics.observations_used['r1'] == 0


def test_a_scan_of_the_second_pass_is_used_although_the_first_had_none_so_late():
    odometry_only = [m for m in PASS if m.topic.endswith('odom')]
    early, later_one = PASS[3], raw_record(scan('r1', 250, [(9, (1.0, 0.0))]))

    ended, run = runs_of(
        [early, *odometry_only, *odometry_only[:7], later_one, *odometry_only[7:]],
        on_time_jump='reset')

    assert counts(ended) == counts(run) == {}
    assert run.estimator.statistics.observations_used['r1'] == 1


def test_a_known_source_of_the_second_pass_may_be_far_ahead():
    odometry_only = [m for m in PASS if m.topic.endswith('odom')]
    scans = [raw_record(scan('r1', ms, [(ms, (1.0, 0.0))])) for ms in (1000, 3950)]

    _, run = runs_of(
        [PASS[3], *odometry_only, *odometry_only[:20], *scans, *odometry_only[20:]],
        on_time_jump='reset')

    assert counts(run) == {}
    assert run.estimator.statistics.observations_used['r1'] == 2


@pytest.mark.parametrize('stray', ['r1', 'r2'])
def test_a_stray_stamp_of_one_robot_far_ahead_stops_no_other(stray):
    stamps = range(0, 30_000, 100)
    drive = [raw_record(odometry(robot, ms)) for ms in stamps for robot in ('r1', 'r2')]
    drive.insert(100, raw_record(odometry(stray, 3_600_000)))

    # Received long after all stamps, as when a bag is played: no clock shows the stray stamp.
    run, = runs_of(later(drive, 1e6))

    other, = {'r1', 'r2'} - {stray}
    assert run.inputs.time_jump_detector.jump is None
    assert run.estimator.used(other) == len(stamps)


def test_after_a_stamp_from_the_future_the_present_is_no_jump():
    ahead = [replace(raw_record(odometry(name, 60_000)), received=2000 * MS)
             for name in ('r1', 'r2')]

    run, = runs_of([*PASS[:80], *ahead, *PASS[80:]], on_time_jump='reset')

    assert hashes([run]) == [HASH]
    assert counts(run) == {'future': 2}


@pytest.mark.parametrize('team', [('r1',), ('r1', 'r2')])
@pytest.mark.parametrize('ahead', [1500, 3000, 3_600_000])
def test_a_single_stamp_ahead_changes_no_bit(team, ahead):
    drive = [m for m in PASS if m.topic.startswith(team)]
    # Received long after all stamps, as when a bag is played: no clock shows the stray stamp.
    stray = later([raw_record(odometry('r1', 2000 + ahead))], 1e6)
    half = len(drive) // 2

    run, = runs_of([*drive[:half], *stray, *drive[half:]], *team)

    assert hashes([run]) == hashes(runs_of(drive, *team))
    assert counts(run) == {'future': 1}
    assert run.inputs.time_jump_detector.jump is None


def test_scans_after_one_with_a_stamp_ahead_wait_for_nothing():
    run = EstimatorSession(run_settings(), None)
    feed(run, PASS[:80])
    feed(run, later([raw_record(scan('r1', 5000, []))], -3.0))

    feed(run, messages_of('r1', PASS[80:120]))

    assert run.inputs.time_jump_detector.held == []


@pytest.mark.parametrize('team', [('r1',), ('r1', 'r2')])
def test_nothing_is_lost_after_a_pause_of_all_robots(team):
    rest = [raw_record(odometry(name, ms)) for ms in range(9000, 10_000, 100) for name in team]
    odometry_only = [m for m in PASS if m.topic.endswith('odom') and m.topic.startswith(team)]

    run, = runs_of([*odometry_only, *rest], *team)

    assert counts(run) == {}
    assert [run.estimator.used(name) for name in team] == [51] * len(team)


def test_the_last_odometry_after_a_pause_is_used_if_the_input_ends_or_begins_again():
    last = raw_record(odometry('r1', 9000))

    closed, = runs_of([*PASS, last])
    ended, begun = runs_of([*PASS, last, *later(PASS)], on_time_jump='reset')

    assert hashes([closed, begun]) == [hashes([ended])[0], HASH]
    assert [counts(run) for run in (closed, ended, begun)] == [{}] * 3
    assert closed.estimator.used('r1') == ONE_PASS.estimator.used('r1') + 1


def test_rare_odometry_is_not_held():
    run = EstimatorSession(run_settings('r1'), None)
    held = []

    for ms in range(0, 20_000, 2000):
        feed(run, [raw_record(odometry('r1', ms))])
        held.append(len(run.inputs.time_jump_detector.snapshot()['ahead']))

    assert held == [0, 1, *[0] * 8]


def test_odometry_that_is_held_is_counted_when_its_robot_leaves():
    left = []
    for messages in PASS, [*PASS, raw_record(odometry('r2', 9000))]:
        run = EstimatorSession(run_settings(), None)
        feed(run, messages)
        run.change_team(['r1'])
        left.append(counts(run)['left'])

    assert left[1] == left[0] + 1


SIMULATED = [raw_record(record) for record in simulation.parse(
    {'loops': 1, 'steps_per_loop': 40, 'landmarks': 12, 'rate': 5}).records()]


@pytest.mark.parametrize(('option', 'folders'), [
    ('refuse', ['out']), ('reset', ['out', 'out_2', 'out_3'])])
def test_replay_of_a_bag_recorded_in_a_loop(tmp_path, capsys, option, folders):
    once = write_bag(tmp_path / 'once', SIMULATED)
    looped = write_bag(
        tmp_path / 'looped', [*SIMULATED, *later(SIMULATED, 20.0), *later(SIMULATED, 40.0)])
    params = write_parameters(
        tmp_path / 'team.yaml', robots=['r1', 'r2'], on_time_jump=option)

    for bag, output in (once, 'expected'), (looped, 'out'):
        words = bag, '--params', params, '--output', tmp_path / output, '--bag'
        assert run_verb('replay', *words) == 0, capsys.readouterr()

    expected, *summaries = (summary_of(tmp_path / name) for name in ('expected', *folders))
    assert [one['state_hash'] for one in summaries] == [expected['state_hash']] * len(folders)
    assert [one['rmse'] for one in summaries] == [expected['rmse']] * len(folders)
    assert not any(one['depends_on_arrival'] for one in summaries)
    assert not (tmp_path / f'out_{len(folders) + 1}').exists()


def test_held_scans_have_a_limited_number_of_observations(monkeypatch):
    monkeypatch.setattr(time_jump, 'MAX_HELD_OBSERVATIONS', 10)
    run = EstimatorSession(run_settings(), None)
    feed(run, PASS)

    for ms in range(500, 560, 10):
        crowd = scan('r1', ms, [(number, (1.0, 0.0)) for number in range(4)])
        run.receive(replace(raw_record(crowd), received=5000 * MS))

    # Two scans are held, the older ones are late.
    assert counts(run) == {'late': 4}


def test_held_scans_always_include_the_newest_one(monkeypatch):
    monkeypatch.setattr(time_jump, 'MAX_HELD_OBSERVATIONS', 3)
    run = EstimatorSession(run_settings(), None)
    feed(run, PASS)

    crowd = scan('r1', 500, [(number, (1.0, 0.0)) for number in range(4)])
    run.receive(replace(raw_record(crowd), received=5000 * MS))

    assert counts(run) == {}
    assert len(run.inputs.time_jump_detector.held) == 1


@pytest.mark.parametrize('stray', [-20, 20])
def test_odometry_far_from_that_before_it_begins_the_records_in_order_anew(stray):
    backward = BackwardOdometry(begin=1000 * NS)
    for second in (100, 101, 100 + stray):
        backward.add(second * NS, longest_gap=2 * NS)

    assert (backward.first, backward.last, backward.count) == (
        (100 + stray) * NS, (100 + stray) * NS, 1)


def test_stamps_before_a_checkpoint_of_a_robot_that_left_hide_no_stamp_ahead():
    run = EstimatorSession(run_settings(), None)
    detector = run.inputs.time_jump_detector
    detector.resume({
        'held': [], 'ahead': [], 'have_paused': [], 'newest': {'r1': 0, 'r2': 1000 * NS}})
    run.change_team(['r1'])
    feed(run, [raw_record(odometry('r1', 100))])

    feed(run, [raw_record(odometry('r1', 500_000))])

    assert [record.stamp for record, _ in detector.snapshot()['ahead']] == [500 * NS]
