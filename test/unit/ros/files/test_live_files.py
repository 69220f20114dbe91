# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A live run never waits for its files; poses wait for the disk, up to a bound."""

from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from fej_slam_ros.atomic_files import PartFile
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.files import live_files
from fej_slam_ros.ros.files.live_files import LiveFiles
from fej_slam_ros.ros.files.run_files import RunFiles
from helpers.ros import csv_rows

POSES = [PoseEstimate('r1', stamp, 'map', np.zeros(3), np.eye(3)) for stamp in range(50)]


@pytest.fixture
def folder(tmp_path):
    return tmp_path / 'out'


@pytest.fixture
def stuck(monkeypatch):
    """Return an event until which the disk takes nothing."""
    free = Event()
    flush = PartFile.flush

    def wait_and_flush(part):
        free.wait()
        flush(part)

    monkeypatch.setattr(PartFile, 'flush', wait_and_flush)
    yield free
    free.set()


def completed(files, timeout=10.0):
    """Complete the files of a run; return what is not complete."""
    files.complete((), [], True, summary={})
    return files.wait(timeout)


def test_files_of_a_live_run_are_those_of_every_run(folder):
    files = LiveFiles(RunFiles(folder, ['r1'], None))
    files.write(POSES)

    assert completed(files) == ''

    assert [int(row['stamp_ns']) for row in csv_rows(folder / 'trajectory_r1.csv')] == [
        *range(50)]
    assert {path.name for path in folder.iterdir()} == {
        'landmarks.csv', 'r1.tum', 'summary.json', 'trajectory_r1.csv'}


def test_a_disk_that_takes_nothing_delays_only_the_end(folder, stuck, monkeypatch):
    monkeypatch.setattr(live_files, 'SLOW_AFTER', 0.0)
    files = LiveFiles(RunFiles(folder, ['r1'], None))
    files.write(POSES)

    assert f'{folder} takes no data for' in files.error
    assert completed(files, 0.05) == f'{folder} is not complete: it is still being written'
    stuck.set()
    assert files.wait(10.0) == ''
    assert len(csv_rows(folder / 'trajectory_r1.csv')) == 50


def test_poses_of_a_robot_that_joins_while_the_disk_stalls_are_written(folder, monkeypatch):
    is_writing, may_write, write = Event(), Event(), RunFiles.write

    def stalled(files, poses):
        is_writing.set()
        may_write.wait(10.0)
        write(files, poses)

    monkeypatch.setattr(RunFiles, 'write', stalled)
    files = LiveFiles(RunFiles(folder, ['r1'], None))
    files.write(POSES[:1])
    assert is_writing.wait(10.0)

    files.add_robots(['r1', 'r2'])
    files.write(replace(pose, robot='r2') for pose in POSES)
    may_write.set()

    assert completed(files) == ''
    assert len(csv_rows(folder / 'trajectory_r2.csv')) == 50


def test_poses_beyond_the_bound_are_lost_and_counted(folder, stuck, monkeypatch):
    monkeypatch.setattr(live_files, 'MAX_WAITING_POSES', 20)
    files = LiveFiles(RunFiles(folder, ['r1'], None))

    files.write(POSES)
    stuck.set()

    assert completed(files) == f'30 poses are missing in {folder}'


def test_files_that_can_be_completed_are_and_the_first_error_is_told(folder):
    files = LiveFiles(RunFiles(folder, ['r1', 'r2'], None))
    (folder / 'trajectory_r1.csv.part').unlink()

    error = completed(files)

    assert error.startswith(f'cannot write {folder / "trajectory_r1.csv"}: No such file')
    assert error.endswith('; not complete: trajectory_r1.csv')
    assert {'r1.tum', 'trajectory_r2.csv', 'summary.json'} <= {
        path.name for path in folder.iterdir()}


def test_a_robot_that_is_added_gets_its_files_also_when_the_disk_is_slow(folder, stuck):
    files = LiveFiles(RunFiles(folder, ['r1'], None))

    files.add_robots(['r1', 'r2'])
    files.write([replace(POSES[0], robot='r2')])
    stuck.set()

    assert completed(files) == ''
    assert len(csv_rows(folder / 'trajectory_r2.csv')) == 1


def test_discarded_files_are_deleted(folder):
    files = LiveFiles(RunFiles(folder, ['r1'], None))

    files.discard()

    assert not folder.exists()


def test_a_second_run_in_the_same_folder_is_refused(folder):
    files = LiveFiles(RunFiles(folder, ['r1'], None))

    with pytest.raises(UserError, match='is in use by process') as refused:
        LiveFiles(RunFiles(folder, ['r2'], None))

    assert not isinstance(refused.value, UsageError)
    files.discard()


def test_incomplete_files_of_a_killed_run_are_deleted_by_the_next_one(folder):
    folder.mkdir()
    for name in ('trajectory_r9.csv.part', 'r9.tum.part', 'summary.json.part', 'other.part'):
        (folder / name).write_text('rest')

    files = LiveFiles(RunFiles(folder, ['r1'], None))

    assert completed(files) == ''
    assert {path.name for path in folder.glob('*.part')} == {'other.part'}
