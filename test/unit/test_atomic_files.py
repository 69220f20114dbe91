# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A file is replaced completely or not at all, whatever happens during writing."""

from contextlib import contextmanager
from itertools import count
import os
import resource
import signal
import sys

import pytest

from fej_slam_ros import atomic_files
from fej_slam_ros.errors import UsageError, UserError

OLD, NEW = b'old', b'new' * 100_000


def killed_at_line(number, path):
    """Write a file in a process that is killed before so many lines; return whether it was."""
    child = os.fork()
    if not child:
        lines = count()

        def trace(frame, event, _):
            if event == 'line' and next(lines) == number:
                os.kill(os.getpid(), signal.SIGKILL)
            return trace if frame.f_code.co_filename == atomic_files.__file__ else None

        sys.settrace(trace)
        atomic_files.write_bytes(path, NEW)
        os._exit(0)
    return os.WIFSIGNALED(os.waitpid(child, 0)[1])


def test_a_kill_at_any_line_leaves_the_old_or_the_new_file(tmp_path):
    path = tmp_path / 'file'
    found = []

    for number in count():
        path.write_bytes(OLD)
        was_killed = killed_at_line(number, path)
        found.append(path.read_bytes())
        if not was_killed:
            break

    assert len(found) > 10
    assert set(found) == {OLD, NEW}
    # Once the new one is there it stays.
    assert found == sorted(found, key=(OLD, NEW).index)


@contextmanager
def files_of_at_most(size):
    """Limit the size of files [bytes]."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def test_a_full_disk_leaves_the_old_file_and_is_reported(tmp_path):
    path = tmp_path / 'file'
    path.write_bytes(OLD)
    with files_of_at_most(1000), pytest.raises(UserError, match=(
            rf'^cannot write {path}: File too large: raise the limit of file sizes')):
        atomic_files.write_bytes(path, NEW)

    assert path.read_bytes() == OLD


def test_of_some_files_all_are_replaced_or_none(tmp_path):
    paths = [tmp_path / 'a' / 'first', tmp_path / 'a' / 'second', tmp_path / 'b' / 'third']
    with files_of_at_most(1000), pytest.raises(UserError, match='File too large'):
        atomic_files.write_all({paths[0]: OLD, paths[2]: OLD, paths[1]: NEW})
    assert not [*tmp_path.iterdir()]

    atomic_files.write_all(dict.fromkeys(paths, NEW))

    assert [path.read_bytes() for path in paths] == [NEW] * 3
    assert len([*tmp_path.rglob('*')]) == 5


def test_paths_below_the_current_folder_are_shown_as_users_type_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    assert atomic_files.short_path(tmp_path / 'bag').as_posix() == 'bag'
    assert atomic_files.short_path(tmp_path / 'out' / '..' / 'bag').as_posix() == 'bag'
    assert atomic_files.short_path(tmp_path) == tmp_path
    assert atomic_files.short_path(tmp_path.parent / 'bag') == tmp_path.parent / 'bag'


@pytest.mark.parametrize('write', [
    lambda path: atomic_files.write_bytes(path, NEW),
    lambda path: atomic_files.refuse_existing([path], force=True)])
def test_a_device_is_never_replaced_by_a_file(tmp_path, write):
    path = tmp_path / 'pipe'
    os.mkfifo(path)

    with pytest.raises(UsageError, match='pipe is a device, pipe or socket: choose the path of a'):
        write(path)

    assert path.is_fifo()
    assert [*tmp_path.iterdir()] == [path]
