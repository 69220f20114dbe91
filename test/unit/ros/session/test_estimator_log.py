# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Each event of a run is one line of its log, with the frame and the cause."""

from dataclasses import replace
import re

import numpy as np
import pytest

from fej_slam_ros.core.records import PosePrior, Scan
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.records import MS, odometry, robot_scan, scan
from helpers.ros import LANDMARKS, log_texts, meeting, raw_record, run_settings


def lines_of(records, *names, **settings):
    """Return the lines of a run over records, without those of first data."""
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
