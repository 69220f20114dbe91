# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The input of a run has a line where it begins, stops, is missing or is rejected."""

from dataclasses import replace

from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from fej_slam_ros.ros.session.run_log import MAX_REMINDERS, REMIND_EVERY
from helpers.records import MS, odometry, scan
from helpers.ros import log_texts, meeting, raw_record, run_settings


def test_a_clock_that_goes_back_leaves_no_robot_that_sends_stale():
    run = EstimatorSession(run_settings('r1', 'r2', on_time_jump='refuse', stale_after=1.0), None)
    for robot in ('r1', 'r2'):
        run.receive(raw_record(odometry(robot, 60_000, (0.0, 0.0, 0.0))))
    # Only r1 sends again.
    for ms in range(1000, 9000, 500):
        run.receive(raw_record(odometry('r1', ms, (0.001 * ms, 0.0, 0.0))))
        run.log.check(ms * MS)

    assert not any('r1 is stale' in text for text in log_texts(run))


def test_input_that_is_rejected_altogether_has_one_line_and_one_when_that_is_over():
    run = EstimatorSession(run_settings('r1'), None)
    lines = []
    for ms in range(0, 6000, 100):
        run.receive(raw_record(odometry('r1', ms, (0.001 * ms, 0.0, 0.0))))
        message = raw_record(scan('r1', ms, [(1, (5.0, 1.0))]))
        is_broken = 1000 <= ms < 4000
        run.receive(replace(message, raw=b'') if is_broken else message)
        list(run.take())
        run.log.check(ms * MS)
        lines += [text for text in log_texts(run) if 'r1/landmarks' in text]

    # After a second.
    rejected, accepted = lines
    assert rejected.startswith('all messages on r1/landmarks are rejected: 11 bad_message: ')
    assert accepted == 'messages on r1/landmarks are accepted again'


def test_first_data_of_a_robot_is_one_line_and_details_are_debug():
    run = EstimatorSession(run_settings(), None)
    run.log.topic_name = '/{}'.format
    for record in meeting():
        run.receive(raw_record(record))

    lines = [(severity.value, text) for severity, text in run.log.take()]

    assert lines == [
        ('info', 'first data of r1 on /r1/odom'), ('info', 'first data of r2 on /r2/odom'),
        ('debug', 'first data of r1 on /r1/landmarks'),
        ('debug', 'first data of r2 on /r2/landmarks')]


def test_stale_robots_are_reported_once_and_when_they_are_back():
    run = EstimatorSession(run_settings(), None)

    def receive(ms, *robots):
        for robot in robots:
            run.receive(raw_record(odometry(robot, ms)))
        run.log.check(ms * MS)

    for ms in range(0, 1000, 100):
        receive(ms, 'r1', 'r2')
    for ms in range(1000, 3000, 100):
        receive(ms, 'r1')
    receive(3000, 'r1', 'r2')

    assert log_texts(run) == [
        'r2 is stale: no odometry for 1.1 s, the others no longer wait for it',
        'r2 is back: odometry after 2.1 s']


def test_input_that_ends_is_no_fault_of_a_robot():
    run = EstimatorSession(run_settings(), None)
    for ms in range(0, 1000, 100):
        for robot in 'r1', 'r2':
            run.receive(raw_record(odometry(robot, ms)))

    for ms in range(900, 5000, 100):
        run.log.check(ms * MS)
    run.receive(raw_record(odometry('r1', 5000)))
    run.log.check(5000 * MS)

    assert log_texts(run) == [
        'input paused: no odometry of any robot for 1.1 s', 'input continues after 4.1 s',
        'r2 is stale: no odometry for 4.1 s, the others no longer wait for it']


def test_reminders_end_and_begin_again_with_other_input():
    run = EstimatorSession(run_settings('r1'), None)
    waiting = 'waiting for odometry of r1 (no driver)'

    for _ in range(3 * REMIND_EVERY * MAX_REMINDERS):
        run.log.remind({'r1': 'no driver'})
    lines = log_texts(run)
    assert len(lines) == MAX_REMINDERS
    assert lines[0].startswith(waiting)
    assert lines[-1].endswith('(last reminder, see /diagnostics)')

    run.receive(raw_record(odometry('r1', 0)))
    run.log.remind({'r1': ''})
    assert log_texts(run) == ['waiting for a landmark observed by the anchor r1']
