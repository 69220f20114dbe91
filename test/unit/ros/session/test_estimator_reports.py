# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics show the state of each robot and of the filter; each event is a line of the log."""

from dataclasses import replace
import re

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.records import Odometry, PosePrior, Scan
from fej_slam_ros.ros.files.run_summary import estimator_summary
from fej_slam_ros.ros.session.estimator_reports import EstimatorDiagnostics
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.input_faults import TopicPublishers
from fej_slam_ros.ros.session.node_conditions import NodeConditions
from fej_slam_ros.ros.topic_types import ODOMETRY
from helpers.records import MS, odometry, robot_scan, scan
from helpers.ros import (
    drive, feed, LANDMARKS, log_texts, meeting, meeting_truth, odometry_message, raw,
    raw_record, run_settings, seen, through_cdr)

OK, WARN, ERROR = 0, 1, 2
NOW = 2_000_000_000


def report_of(*messages, **options):
    run = EstimatorSession(run_settings(**options), None)
    drive(run, messages)
    # A delayed robot does not make the others silent.
    newest = {message.topic.partition('/')[0]: message.received for message in messages}
    return statuses(run.diagnostics, min(newest.values()))


def statuses(diagnostics, now):
    """Return level, message and values of each status, by the last word of its name."""
    topic, message = diagnostics.report(now, at_rest=True)
    assert topic == '/diagnostics'
    return {
        status.name.split()[-1]: (
            status.level, status.message, {v.key: v.value for v in status.values})
        for status in through_cdr(message).status}


MEETING = [raw_record(record) for record in meeting()]


def test_each_robot_and_the_filter_have_a_status():
    report = report_of(*map(raw_record, meeting(steps=2)))

    assert {name: (level, message) for name, (level, message, _) in report.items()} == {
        'r1': (OK, 'in map'), 'r2': (OK, 'in map'), 'filter': (OK, 'running'),
        'qos': (OK, 'compatible'), 'files': (OK, 'no error')}


def test_the_input_statistics_of_a_robot_are_reported():
    late = raw('r1/odom', odometry_message(50), 400)
    twice = seen((7, 1.0, 0.0), (7, 2.0, 0.0), ms=400)

    _, _, values = report_of(*MEETING, late, raw('r1/landmarks', twice, 420))['r1']

    assert {key: values[key] for key in ('received', 'used', 'sightings_used', 'delay_s')} == {
        'received': '11', 'used': '9', 'sightings_used': '12', 'delay_s': '0.02'}
    assert (values['late'], values['duplicate_id']) == ('1', '2')
    assert float(values['longest_late_s']) == pytest.approx(0.35)


def test_the_rate_refers_to_the_time_since_the_last_report():
    run = EstimatorSession(run_settings(), None)

    rates = []
    for now, count in ((NOW, 4), (2 * NOW, 8), (3 * NOW, 0)):
        for k in range(count):
            run.receive(raw('r1/odom', odometry_message((now + k) / 1e6)))
        rates.append(statuses(run.diagnostics, now)['r1'][2]['rate_hz'])

    assert rates == ['0.0', '4.0', '0.0']


def test_the_reason_is_reported_for_a_robot_that_is_not_in_the_map():
    report = report_of(raw_record(odometry('r1', 0)))

    assert report['r2'][:2] == (WARN, 'r2 not joined: it sent no usable odometry')


@pytest.mark.parametrize('observer', ['r1', 'r2', None])
def test_missing_observations_are_a_fault_of_robots_that_need_them_to_get_into_map(observer):
    records = [odometry(robot, ms) for ms in range(0, 10_000, 100) for robot in ('r1', 'r2')]
    if observer:
        records += [scan(observer, ms, [(1, (5.0, 1.0))]) for ms in range(0, 10_000, 100)]
    run = EstimatorSession(run_settings(), None)
    drive(run, [raw_record(record) for record in sorted(records, key=lambda r: r.stamp)])
    run.diagnostics.conditions = NodeConditions(publishers={
        f'{robot}/{kind}': TopicPublishers(f'/{robot}/{kind}', types)
        for robot in ('r1', 'r2')
        for kind, types in (('odom', (ODOMETRY,)), ('landmarks', ()), ('robots', ()))})

    faults = run.diagnostics.input_faults(10_000 * MS)

    # The anchor needs them for step 0, r2, which has no initial pose, in order to join.
    assert {robot for robot, fault in faults.items() if 'have no publisher' in fault} == (
        {'r1', 'r2'} - {observer})


def test_a_robot_with_too_few_observations_reports_how_many_it_needs():
    records = [
        record for ms in (0, 200) for record in (
            odometry('r1', ms), odometry('r2', ms), robot_scan('r1', ms, [('r2', (3.0, 1.0))]))]

    report = report_of(*(raw_record(record, {'r2': 2}) for record in records))

    assert report['r2'][:2] == (
        WARN, 'r2 not joined: 0 shared landmarks and 2 observations of robots, needs 3')


@pytest.mark.parametrize(('sigma', 'level', 'message'), [
    (0.0, ERROR, 'underconfident by '), (0.1, OK, 'in map'), (0.2, WARN, 'overconfident by '),
    (0.4, ERROR, 'overconfident by ')])
def test_nis_that_stays_outside_its_chi_square_band_is_reported(sigma, level, message):
    rng = np.random.default_rng(3)
    records = [odometry('r1', 0), scan('r1', 0, [(1, (5.0, 1.0)), (2, (5.0, -1.0))])]
    for ms in range(100, 20100, 100):
        x, y = rng.normal((5.0 - ms / 1000.0, 1.0), sigma)
        records += [odometry('r1', ms), scan('r1', ms, [(1, (x, y))])]

    of_level, of_message, values = report_of(
        *map(raw_record, records), gate_probability=1.0)['r1']

    low, high = chi2.interval(0.999999, 400) / np.array(400)
    assert values['nis_band'] == f'{low:.3f}..{high:.3f}'
    assert of_level == level
    assert of_message.startswith(message)


def misled(shift, since, robots=('r1', 'r2'), numbers=(1, 2, 3), steps=40):
    """Return messages with shifted observations of some landmarks, from a time in ms on."""
    def seen(record):
        if record.robot not in robots or isinstance(record, Odometry) or record.stamp < since * MS:
            return record
        return replace(record, observations=tuple(
            replace(s, z=s.z + shift) if s.id in numbers else s for s in record.observations))

    return [raw_record(seen(record)) for record in meeting(steps)]


def delayed(robot, seconds):
    """Return the messages of the meeting, those of one robot received with a delay."""
    return [
        replace(m, received=m.received + round(seconds * 1e9)) if m.topic.startswith(robot) else m
        for m in MEETING]


@pytest.mark.parametrize(('seconds', 'side'), [(1.5, 'behind'), (-1.5, 'ahead of')])
def test_stamps_that_differ_from_the_clock_of_reception_are_a_warning(seconds, side):
    report = report_of(*delayed('r2', seconds))

    message = f'in map; stamps of r2 are 1.500 s {side} the clock of reception'
    assert report['r2'][:2] == (WARN, message)
    assert report['r1'][:2] == (OK, 'in map')


def test_the_limit_for_clock_differences_is_a_parameter():
    assert report_of(*delayed('r2', 1.5), clock_limit=2.0)['r2'][:2] == (OK, 'in map')
    assert report_of(*delayed('r2', 0.0), clock_limit=0.0)['r2'][:2] == (OK, 'in map')


def test_a_frame_that_has_changed_is_a_warning():
    renamed = odometry_message(500)
    renamed.header.frame_id = 'wheels'

    level, message, _ = report_of(*MEETING, raw('r1/odom', renamed, 500))['r1']

    assert level == WARN
    assert "the frame of its odometry has changed from 'r1/odom' to 'wheels'" in message


def test_the_clock_offset_to_the_other_robots_is_reported():
    report = report_of(*delayed('r2', -0.25))

    offsets = [float(report[name][2]['clock_offset_s']) for name in ('r1', 'r2')]
    assert offsets == pytest.approx([-0.25, 0.25])
    assert 'clock_offset_s' not in report_of(*delayed('r2', 0.0)[::2])['filter'][2]


def test_a_jump_back_in_time_is_an_error_with_its_remedy():
    once = [raw_record(odometry(f'r{k}', ms)) for ms in range(0, 4000, 100) for k in (1, 2)]

    report = report_of(*once, *once)

    assert report['filter'][0] == ERROR
    assert report['filter'][1] == (
        'time jumped back by 3.900 s, all input is rejected: call ~/reset to start a new run')
    assert report['r1'][2]['after_time_jump'] == '40'


def test_errors_against_ground_truth_are_those_of_the_summary():
    run = EstimatorSession(run_settings(anchor_sigma=(0.1, 0.1, 0.1)), None)
    drive(run, map(raw_record, [*meeting_truth(), *meeting()]))

    report = statuses(run.diagnostics, NOW)

    expected = estimator_summary(run.estimator, run.inputs.unused, run.settings)
    for name in ('r1', 'r2'):
        _, _, values = report[name]
        assert float(values['nees']) == pytest.approx(expected['nees'][name], abs=5e-4)
        for key, quantity in ('position_rmse_m', 'position'), ('heading_rmse_rad', 'heading'):
            assert float(values[key]) == pytest.approx(expected['rmse'][name][quantity], abs=5e-7)


def test_the_latest_nees_is_that_of_the_latest_pose():
    run = EstimatorSession(run_settings(anchor_sigma=(0.1, 0.1, 0.1)), None)
    published = drive(run, map(raw_record, [*meeting_truth(), *meeting()]))

    _, _, values = statuses(run.diagnostics, NOW)['r2']

    *_, last = (through_cdr(message).pose for topic, message in published if topic == 'r2/pose')
    place, turn = last.pose.position, last.pose.orientation
    x, y, heading = meeting_truth()[-1].pose
    error = np.array([place.x - x, place.y - y, 2.0 * np.arctan2(turn.z, turn.w) - heading])
    P = last.covariance.reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
    assert float(values['nees_latest']) == pytest.approx(
        error @ np.linalg.inv(P) @ error / 3.0, abs=5e-4)  # reported to three decimals


def test_without_ground_truth_no_errors_are_reported():
    _, _, values = report_of(*MEETING)['r1']

    assert not {'nees', 'nees_latest', 'position_rmse_m', 'heading_rmse_rad'} & set(values)


def test_a_robot_that_is_likely_lost_is_an_error():
    report = report_of(*misled((5.0, 0.0), since=3700, robots=['r1']))

    assert report['r1'][:2] == (ERROR, 'likely lost: 9 of 9 observations gated in a row')
    assert report['r2'][:2] == (OK, 'in map')


def test_inflated_observations_are_counted():
    report = report_of(*misled((5.0, 0.0), since=3700, robots=['r1']), inflate_rejected_scans=True)

    assert report['r1'][0] == ERROR
    assert (report['r1'][2]['sightings_relaxed'], report['r2'][2]['sightings_relaxed']) == (
        '9', '0')


def test_moved_landmarks_are_a_warning_with_their_ids():
    report = report_of(*misled((2.0, 0.0), since=1000, numbers=[2]))

    assert report['filter'][:2] == (WARN, 'landmarks were moved')
    assert report['filter'][2]['moved_landmarks'] == '2'
    assert int(report['r1'][2]['moved_landmark']) > 0


def test_a_result_that_depended_on_arrival_is_a_warning():
    late = raw('r1/odom', odometry_message(50), 400)

    assert report_of(*MEETING, late)['filter'][:2] == (
        WARN, 'the result depended on the order of arrival')


def test_the_filter_reports_its_size_its_step_times_and_its_state_hash():
    run = EstimatorSession(run_settings(), None)
    drive(run, MEETING)
    diagnostics = EstimatorDiagnostics(run.estimator, run.inputs, run.settings.node)
    diagnostics.step_times += [0.25, 0.5, 0.125]
    diagnostics.latencies += [0.75]

    _, _, first = statuses(diagnostics, NOW)['filter']
    _, _, second = statuses(diagnostics, 2 * NOW)['filter']

    assert first == {
        'filter': 'fej', 'robots': '2', 'landmarks': '3', 'provisional_landmarks': '0',
        # Of three, 99 % is 0.98 of the way from the second to the third.
        'steps': '3', 'median_step_s': '0.25', 'p99_step_s': '0.495', 'longest_step_s': '0.5',
        'median_latency_s': '0.75', 'p99_latency_s': '0.75', 'longest_latency_s': '0.75',
        'state_hash': run.estimator.state_hash()}
    assert (second['steps'], second['longest_step_s']) == ('0', '0.0')


def test_observations_without_ids_are_counted_by_outcome():
    unnamed = [(-1, (4.0, 3.0)), (-1, (6.0, -5.0))]
    records = [
        record for ms in range(0, 500, 100) for record in (
            odometry('r1', ms, (0.0, 0.0, 0.0)),
            scan('r1', ms, [(-1, (4.0, 3.5))] if ms == 400 else unnamed))]

    report = report_of(*map(raw_record, records))

    _, _, of_robot = report['r1']
    assert {name: n for name, n in of_robot.items() if name.startswith('unnamed')} == {
        'unnamed_matched': '6', 'unnamed_new': '2', 'unnamed_doubtful': '1',
        'unnamed_settled': '2', 'unnamed_merged': '0'}
    assert of_robot['doubtful_match'] == '1'
    assert report['filter'][2]['landmarks'] == '2'


def test_files_that_cannot_be_written_are_an_error_with_its_reason():
    run = EstimatorSession(run_settings(), None)
    run.diagnostics.conditions = NodeConditions(
        file_errors={'checkpoint': 'cannot write it: No space left on device'})

    run.receive(raw_record(odometry('r1', 0)))
    level, message, _ = statuses(run.diagnostics, 0)['files']

    assert (level, message) == (2, 'cannot write it: No space left on device')


def lines_of(records, *names, **settings):
    """Return the lines of the log of a run over records, without those of first data."""
    run = EstimatorSession(run_settings(*names, **settings), None)
    for record in records:
        run.receive(raw_record(record, {name: k for k, name in enumerate(run.consumer.robots, 1)}))
        list(run.take())
    list(run.release())
    return log_texts(run)


def test_a_meeting_in_the_order_of_its_events():
    assert lines_of(meeting()) == [
        'r1 joined map, by its anchor_pose',
        'step 0 at 0.100 s: the anchor r1 observes its first landmark, in map: r1, r2',
        'r2 joined map, by the observations at step 0']


def test_a_robot_that_joins_later_names_the_shared_landmarks():
    records = [
        record for record in meeting(10)
        if not (record.robot == 'r2' and isinstance(record, Scan) and record.stamp < 500 * MS)]

    assert lines_of(records)[2:] == ['r2 joined map, by 3 shared landmarks']


def test_a_robot_that_joins_by_observations_of_robots_names_them():
    records = [scan('r1', 100, [(1, (5.0, 1.0))])] + [
        record for ms in range(0, 6000, 200) for record in (
            odometry('r1', ms, (0.001 * ms, 0.0, 0.0)),
            odometry('r2', ms, (0.0, 0.001 * ms, 0.0)),
            robot_scan('r1', ms, [('r2', (3.0 - 0.001 * ms, 1.0 + 0.001 * ms))]))]

    joined, = [line for line in lines_of(records) if line.startswith('r2')]

    assert re.fullmatch(r'r2 joined map, by \d+ robot-to-robot observations', joined)


def test_a_known_start_is_the_cause():
    known = [('r2', (1.0, -3.0, 0.0), (0.1, 0.1, 0.1))]

    assert 'r2 joined map, by its start_pose' in lines_of(meeting(), known=known)


def test_a_pose_at_the_first_odometry_is_the_cause():
    placed = PosePrior('r2', 0, np.array([1.0, -3.0, 0.0]), 0.01 * np.eye(3))

    assert 'r2 joined map, by set_pose' in lines_of([placed, *meeting()])


def test_a_robot_that_was_asked_to_relocalize_has_not_joined_by_a_pose():
    run = EstimatorSession(run_settings(), None)
    records = [raw_record(record) for record in meeting(30)]
    half = len(records) // 2
    list(feed(run, records[:half]))

    list(feed(run, [raw_record(run.relocalization('r2')), *records[half:]]))

    joins = [line for line in log_texts(run) if line.startswith('r2 joined map, by ')]
    assert len(joins) == 2
    assert not any('set_pose' in line for line in joins)


def test_a_start_that_a_robot_no_longer_uses_when_it_comes_back_is_not_the_cause():
    known = [('r2', (1.0, -3.0, 0.0), (0.1, 0.1, 0.1))]
    run = EstimatorSession(run_settings(known=known), None)
    messages = [raw_record(record) for record in meeting(41)]

    feed(run, messages[:80])
    run.change_team(['r1'])
    run.log.take()
    run.change_team(['r1', 'r2'])
    feed(run, messages[80:])

    assert 'r2 joined map, by its observations' in log_texts(run)


def test_a_prior_map_is_the_cause(tmp_path):
    path = tmp_path / 'landmarks.csv'
    rows = [f'{id_},{x},{y},0.01,0.0,0.01,map' for id_, (x, y) in LANDMARKS.items()]
    path.write_text('\n'.join(['id,x,y,var_x,cov_xy,var_y,frame', *rows, '']))

    lines = lines_of(meeting(), anchor='', prior_landmarks=str(path))

    assert lines == [
        'r1 joined map, by 3 shared landmarks of the prior map',
        'r2 joined map, by 3 shared landmarks of the prior map']


def prior(stamp, x):
    return PosePrior('r2', stamp * MS, np.array([x, -3.0, 0.0]), 0.01 * np.eye(3))


def test_a_pose_prior_is_accepted_and_is_the_cause():
    records = [record for record in meeting(8) if not (
        record.robot == 'r2' and isinstance(record, Scan))]

    lines = lines_of([*records[:6], prior(200, 1.2), *records[6:]])

    assert lines[2:] == ['r2 joined map, by set_pose', 'set_pose of r2 accepted']


def test_a_pose_prior_that_arrives_late_is_named_as_such():
    records = meeting(20)

    lines = lines_of([*records[:-4], prior(200, 1.2), *records[-4:]])

    # Odometry is there up to 1.8 s, so that all steps before 1.7 s are done (max_delay of 0.1 s).
    assert ('set_pose of r2 accepted 1.5 s after its stamp: the robot is placed where it was'
            ' then') in lines


def test_pose_priors_that_arrive_ever_later_do_not_fill_the_log():
    late = [prior(200 + k, 1.2) for k in range(40)]
    records = [*meeting(20), *(
        record for k, given in enumerate(late) for record in (
            odometry('r1', 2000 + 100 * k), odometry('r2', 2000 + 100 * k), given))]

    lines = [line for line in lines_of(records) if 'after its stamp' in line]

    assert len(lines) == 6
    assert lines[-1].endswith('(10 times)')


def test_a_stream_of_pose_priors_is_named_once():
    records = meeting(20)
    for k in range(8):
        records.append(odometry('r2', 2000 + 100 * k, (0.1 * k, 0.0, 0.0)))
        records.append(prior(2000 + 100 * k, 3.0 + 0.1 * k))

    lines = lines_of(records)

    warning, = (line for line in lines if 'GPS' in line)
    assert warning == (
        'set_pose of r2 has come 5 times in 0.4 s: each restarts the robot, so that poses of GPS'
        ' or of another localisation make it less accurate')


def test_a_rejected_pose_prior_has_its_reason():
    records = meeting(8)

    lines = lines_of([*records[:2], prior(100, 0.0), *records[2:]])

    assert lines[-1] == (
        'set_pose of r2 rejected: the robot has joined map at the same step, by what it observes')


@pytest.mark.parametrize(('P', 'line'), [
    (0.01 * np.eye(3), 'set_pose of r2 accepted'),
    (10.0 * np.eye(3), 'r2 restarts at a pose that is not known')])
def test_a_pose_prior_of_a_robot_in_map_is_accepted(P, line):
    records = [*meeting(8), odometry('r2', 900)]

    lines = lines_of([*records, replace(prior(0, 0.0), stamp=650 * MS, P=P)])

    assert line in lines


def test_a_gap_too_long_to_predict_is_a_restart():
    noise = np.diag([10.0, 10.0, 10.0])
    records = meeting(5) + [
        replace(odometry('r2', 60_000 + ms), twist_covariance=noise) for ms in (0, 100)]

    lines = lines_of(records, stale_after=100.0)

    assert lines[-1] == (
        'r2 restarts: the gap in its odometry is too long, or its twist.covariance too large, for'
        ' a prediction')


def test_odometry_that_jumps_is_a_restart_with_the_jump():
    records = [
        replace(r, pose=r.pose + np.array([30.0, 0.0, 0.0]))
        if r.robot == 'r2' and not isinstance(r, Scan) and r.stamp > 500 * MS else r
        for r in meeting(10)]

    restarted, joined = lines_of(records)[3:5]

    assert re.fullmatch(r'r2 restarts: its odometry moved 30\.\d m in 0\.10 s', restarted)
    assert joined == 'r2 joined map, by its observations'


def test_odometry_of_two_drivers_is_one_line_of_restarts():
    jumps = [
        replace(r, pose=r.pose + np.array([30.0 * (r.stamp // (100 * MS) % 2), 0.0, 0.0]))
        if r.robot == 'r2' and not isinstance(r, Scan) and r.stamp > 500 * MS else r
        for r in meeting(60)]

    lines = lines_of(jumps)

    assert sum('r2 restarts' in line for line in lines) == 1
    assert sum('r2 joined map' in line for line in lines) == 2


def test_a_lost_robot_restarts_and_recovers():
    def turned(record):
        return replace(record, observations=tuple(
            replace(o, z=-o.z) for o in record.observations))

    records = [
        turned(r) if r.robot == 'r2' and isinstance(r, Scan) and 500 * MS < r.stamp < 2000 * MS
        else r for r in meeting(60)]

    lines = lines_of(records)

    assert lines[3] == 'r2 restarts: likely lost, 9 of 9 observations gated in a row'
    assert lines[4] == 'r2 is likely lost: 9 of 9 observations gated in a row'
    assert lines[-1] == 'r2 has recovered: its observations fit the map again'
    # While it is lost, further restarts are no lines.
    assert sum('restarts' in line for line in lines) == 1


@pytest.mark.parametrize(('mode', 'what'), [
    ('report', 'its observations are rejected'),
    ('forget', 'it starts again where it is observed next')])
def test_a_moved_landmark_is_one_line(mode, what):
    def moved(record):
        if not isinstance(record, Scan) or record.stamp < 1000 * MS:
            return record
        shift = np.array([2.0, 0.0])
        return replace(record, observations=tuple(
            replace(s, z=s.z + shift) if s.id == 2 else s for s in record.observations))

    lines = lines_of(map(moved, meeting(40)), moved_landmarks=mode)

    assert [line for line in lines if 'moved' in line] == [f'landmark 2 was moved: {what}']


def test_a_robot_without_odometry_is_not_waited_for_to_join():
    run = EstimatorSession(run_settings('r1', 'r2', 'r3'), None)
    feed(run, [m for m in MEETING if m.topic.startswith('r1')])
    feed(run, [raw_record(odometry('r2', ms)) for ms in range(0, 500, 100)])
    list(run.release())

    run.log.remind(dict.fromkeys(run.consumer.robots, 'silent'))

    assert log_texts(run)[-1] == (
        'waiting for odometry of r3 (silent); r2 to join map (0 shared landmarks, needs 3)')


def test_a_lost_robot_is_not_called_underconfident():
    report = report_of(*misled((5.0, 0.0), since=29_700, robots=['r1'], steps=300))

    assert report['r1'][:2] == (ERROR, 'likely lost: 9 of 9 observations gated in a row')
