# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two processes never write to one file or folder, and a killed one leaves nothing locked."""

import os
from pathlib import Path
import signal
import socket

import pytest

from fej_slam_ros.errors import UsageError
from fej_slam_ros.output_lock import InUseError, OutputLock

BOTH = pytest.mark.parametrize('lock', [OutputLock.of_file, OutputLock.of_folder])


class Other:
    """Another process that has a lock."""

    def __init__(self, lock, path):
        reader, writer = os.pipe()
        self.pid = os.fork()
        if not self.pid:
            lock(path)
            os.write(writer, b'.')
            signal.pause()
        os.read(reader, 1)
        os.close(reader)
        os.close(writer)

    def kill(self):
        os.kill(self.pid, signal.SIGKILL)
        os.waitpid(self.pid, 0)


@BOTH
def test_the_second_process_is_told_which_one_is_the_first(tmp_path, lock):
    path = tmp_path / 'out'
    other = Other(lock, path)

    try:
        with pytest.raises(InUseError) as refused:
            lock(path)
    finally:
        other.kill()

    assert str(refused.value).startswith(
        f'{path} is in use by process {other.pid} on {socket.gethostname()} since 20')


@BOTH
def test_a_killed_process_leaves_its_name_and_no_lock(tmp_path, lock):
    path = tmp_path / 'out'
    other = Other(lock, path)
    other.kill()

    with lock(path) as mine:
        assert f'process {other.pid} on' in mine.earlier


@BOTH
def test_a_released_lock_leaves_no_file_and_no_folder(tmp_path, lock):
    with lock(tmp_path / 'out') as first:
        assert first.earlier == ''
    with lock(tmp_path / 'out') as second:
        assert second.earlier == ''

    assert not [*tmp_path.iterdir()]


def test_a_file_is_no_folder_and_stays(tmp_path):
    file = tmp_path / 'out'
    file.write_text('of the user')

    with pytest.raises(UsageError, match='out is a file: choose a folder for the results'):
        OutputLock.of_folder(file)
    assert file.read_text() == 'of the user'


def test_a_folder_with_files_stays(tmp_path):
    with OutputLock.of_folder(tmp_path / 'out'):
        (tmp_path / 'out' / 'file').write_text('')

    assert [path.name for path in (tmp_path / 'out').iterdir()] == ['file']


@pytest.mark.parametrize('path', ['', '.', '/'])
def test_a_path_without_a_name_is_no_file(path):
    with pytest.raises(UsageError, match='is not the name of a file to write: give one'):
        OutputLock.of_file(Path(path))
