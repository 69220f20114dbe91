# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The files of a run equal its estimates bit for bit, and appear only at its end."""

import numpy as np
import pytest

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import Odometry
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.records import odometry, team
from helpers.ros import (
    csv_rows, decoded, drive, finished_run, meeting, noisy_meeting, raw_record, run_settings)

NAMES = {
    'landmarks.csv', 'r1.tum', 'r2.tum', 'summary.json', 'trajectory_r1.csv', 'trajectory_r2.csv'}


@pytest.fixture
def folder(tmp_path):
    return tmp_path / 'results'


def estimates(messages, **options):
    """Return the poses that the estimator gives for what is in the messages, and itself."""
    estimator, poses = Estimator(team(**options)), {'r1': [], 'r2': []}
    for message in messages:
        estimator.add(decoded(message), message.received)
    for result in estimator.close():
        for pose in result.poses:
            poses[pose.robot].append(pose)
    return poses, estimator


def first_line(path):
    return path.read_text(encoding='utf-8').partition('\n')[0]


def test_a_run_writes_exactly_its_files(folder):
    finished_run(folder, noisy_meeting())

    assert {path.name for path in folder.iterdir()} == NAMES
    assert first_line(folder / 'trajectory_r1.csv') == (
        'stamp_ns,x,y,yaw,cov_xx,cov_xy,cov_xyaw,cov_yy,cov_yyaw,cov_yawyaw,frame')
    assert first_line(folder / 'landmarks.csv') == 'id,x,y,var_x,cov_xy,var_y,frame'


@pytest.mark.parametrize('robot', ['r1', 'r2'])
def test_a_trajectory_file_equals_the_estimates_bit_for_bit(folder, robot):
    finished_run(folder, noisy_meeting())

    expected, _ = estimates(noisy_meeting())
    written = csv_rows(folder / f'trajectory_{robot}.csv')
    assert len(written) == len(expected[robot]) == 8
    for row, pose in zip(written, expected[robot]):
        assert (int(row['stamp_ns']), row['frame']) == (pose.stamp, pose.frame)
        assert [float(row[name]) for name in ('x', 'y', 'yaw')] == pose.pose.tolist()
        names = 'xx', 'xy', 'xyaw', 'yy', 'yyaw', 'yawyaw'
        assert [float(row[f'cov_{name}']) for name in names] == [
            pose.P[i, j] for i in range(3) for j in range(i, 3)]


def test_the_map_file_equals_the_estimates_bit_for_bit(folder):
    finished_run(folder, noisy_meeting())

    _, estimator = estimates(noisy_meeting())
    state = estimator.groups.team.state
    written = csv_rows(folder / 'landmarks.csv')
    assert [(int(row['id']), row['frame']) for row in written] == [(i, 'map') for i in (1, 2, 3)]
    for row in written:
        landmark = state.landmarks['', int(row['id'])]
        P = state.marginal([landmark])
        assert [float(row['x']), float(row['y'])] == state.estimate(landmark).tolist()
        assert [float(row[name]) for name in ('var_x', 'cov_xy', 'var_y')] == [
            P[0, 0], P[0, 1], P[1, 1]]


def test_each_row_has_its_frame_and_tum_the_last_one_only(folder):
    finished_run(folder, noisy_meeting())

    trajectory = csv_rows(folder / 'trajectory_r2.csv')
    assert [row['frame'] for row in trajectory] == ['r2/map'] + ['map'] * 7
    tum = [line.split() for line in (folder / 'r2.tum').read_text().splitlines()]
    assert [line[0] for line in tum] == [f'0.{k}00000000' for k in range(1, 8)]
    for line, row in zip(tum, trajectory[1:]):
        _, x, y, z, qx, qy, qz, qw = map(float, line)
        assert (x, y, z, qx, qy) == (float(row['x']), float(row['y']), 0.0, 0.0, 0.0)
        # The half angle's sine and cosine are rounded.
        assert 2.0 * np.arctan2(qz, qw) == pytest.approx(float(row['yaw']), abs=1e-15)


def test_a_robot_that_never_moved_has_a_header_and_no_rows(folder):
    finished_run(folder, [raw_record(odometry('r1', 0))])

    assert csv_rows(folder / 'trajectory_r2.csv') == []
    assert (folder / 'r2.tum').read_text() == ''


def test_ids_that_are_not_shared_are_listed_in_ids_csv(folder):
    finished_run(folder, map(raw_record, meeting()), shared_landmark_ids=False)

    landmarks, ids = csv_rows(folder / 'landmarks.csv'), csv_rows(folder / 'ids.csv')
    assert first_line(folder / 'ids.csv') == 'landmark,robot,id'
    assert [row['id'] for row in landmarks] == [row['landmark'] for row in ids] == list('123456')
    assert [(row['frame'], i['robot'], i['id']) for row, i in zip(landmarks, ids)] == [
        *(('map', 'r1', n) for n in '123'), *(('r2/map', 'r2', n) for n in '123')]


def test_no_file_has_its_name_before_the_run_is_over(folder):
    run = EstimatorSession(run_settings(), folder)

    drive(run, noisy_meeting())

    assert not NAMES & {path.name for path in folder.iterdir()}


@pytest.mark.parametrize('name', sorted(NAMES | {'ids.csv'}))
def test_nothing_of_an_earlier_run_is_overwritten(folder, name):
    folder.mkdir()
    (folder / name).write_text('precious')

    with pytest.raises(UsageError, match=rf'{name} exists: .*--force'):
        EstimatorSession(run_settings(), folder, force=False)

    assert [(p.name, p.read_text()) for p in folder.iterdir()] == [(name, 'precious')]


def test_force_replaces_an_earlier_run_when_the_new_one_is_over(folder):
    finished_run(folder, map(raw_record, meeting()), shared_landmark_ids=False)
    before = (folder / 'trajectory_r1.csv').read_text()

    run = EstimatorSession(run_settings(), folder, force=True)
    untouched = (folder / 'trajectory_r1.csv').read_text()
    run.write_files()

    assert untouched == before
    assert csv_rows(folder / 'trajectory_r1.csv') == []


def test_force_deletes_an_ids_csv_that_no_longer_applies(folder):
    finished_run(folder, map(raw_record, meeting()), shared_landmark_ids=False)

    finished_run(folder, noisy_meeting(), force=True)

    assert {path.name for path in folder.iterdir()} == NAMES


def test_force_deletes_what_an_earlier_run_of_other_robots_has_left(folder):
    finished_run(folder, map(raw_record, meeting()))
    (folder / 'alignment.json').write_text('of a smoother')
    (folder / 'notes.csv').write_text('of the user')

    run = EstimatorSession(run_settings('r1'), folder, force=True)
    kept = {path.name for path in folder.iterdir()}
    run.write_files()

    assert kept >= NAMES
    assert {path.name for path in folder.iterdir()} == {
        'landmarks.csv', 'notes.csv', 'r1.tum', 'summary.json', 'trajectory_r1.csv'}


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / 'file').write_text('')

    with pytest.raises(UserError, match=r'cannot write .*file'):
        EstimatorSession(run_settings(), tmp_path / 'file' / 'results')


def test_a_run_without_a_folder_has_a_summary():
    run, summary = finished_run(None, noisy_meeting())

    assert summary['state_hash'] == run.estimator.state_hash()


def test_present_day_stamps_keep_their_nanoseconds(folder):
    now = 1_795_000_000_003_456_789
    finished_run(folder, [raw_record(Odometry('r1', now, np.zeros(3), None))])

    (row,) = csv_rows(folder / 'trajectory_r1.csv')
    assert (folder / 'r1.tum').read_text().startswith('1795000000.003456789 ')
    assert int(row['stamp_ns']) == now
