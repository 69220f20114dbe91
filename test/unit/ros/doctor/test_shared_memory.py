# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shared memory is stale if no process has locked it or opened it; nothing else is touched."""

import fcntl
import mmap
import os

import pytest

from fej_slam_ros.ros.doctor import shared_memory
from helpers.ros import assert_one_sentence, run_verb

SEGMENT, PORT = 'fastrtps_0123456789abcdef', 'fastrtps_port7413'
PORT_FILES = {PORT, f'{PORT}_el', f'sem.{PORT}_mutex'}
OTHERS = {'sem.other', 'fastrtps_0123', f'{SEGMENT}_elx', 'my_fastrtps_port7413'}


@pytest.fixture
def folder(tmp_path):
    """Return a folder with the files of a segment, of a port and of other programs."""
    for name in {SEGMENT, f'{SEGMENT}_el'} | PORT_FILES | OTHERS:
        (tmp_path / name).write_bytes(bytes(8))
    return tmp_path


@pytest.fixture
def doctor(folder, monkeypatch, capsys):
    """Return a function that runs doctor and returns status and outputs."""
    monkeypatch.setattr(shared_memory, 'FOLDER', folder)
    monkeypatch.setattr(shared_memory.survey, '__defaults__', (folder,))
    return lambda *words: (run_verb('doctor', *words), *capsys.readouterr())


def stale(folder):
    return [memory.name for memory in shared_memory.survey(folder) if memory.is_stale]


def names(folder):
    return {path.name for path in folder.iterdir()}


def test_memory_that_no_process_uses_is_stale(folder):
    assert stale(folder) == [SEGMENT, PORT]
    assert [memory.size for memory in shared_memory.survey(folder)] == [16, 24]


@pytest.mark.parametrize('kind', [fcntl.LOCK_EX, fcntl.LOCK_SH])
def test_locked_memory_is_in_use(folder, kind):
    with (folder / f'{SEGMENT}_el').open() as lock:
        fcntl.flock(lock, kind)

        assert stale(folder) == [PORT]


@pytest.mark.parametrize('name', [PORT, f'sem.{PORT}_mutex'])
def test_memory_that_a_process_has_open_is_in_use(folder, name):
    with (folder / name).open('r+b') as file, mmap.mmap(file.fileno(), 0):
        assert stale(folder) == [SEGMENT]


def test_memory_of_other_users_is_left_alone(folder, monkeypatch):
    monkeypatch.setattr(os, 'geteuid', lambda: os.getuid() + 1)

    assert stale(folder) == []


def test_stale_memory_is_listed_and_kept(doctor, folder):
    before = names(folder)

    status, output, errors = doctor('--system')

    assert (status, errors) == (0, '')
    assert f'stale: {PORT}: 0 kB' in output
    assert '2 segments and ports of Fast DDS, 0 in use, 2 stale (0.0 MB), 0 of other' in output
    assert 'cure: fej_slam doctor --system --delete-stale' in output
    assert names(folder) == before


def test_only_stale_memory_is_deleted_on_request(doctor, folder):
    with (folder / f'{SEGMENT}_el').open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)

        status, output, _ = doctor('--system', '--delete-stale')

    assert (status, f'deleted: {PORT}' in output) == (0, True)
    assert names(folder) == {SEGMENT, f'{SEGMENT}_el'} | OTHERS


@pytest.mark.parametrize('words', [
    ('--json', 'report.json'), ('--params', 'team.yaml'), ('--namespace', 'fleet')])
def test_options_for_a_bag_are_refused_for_the_system(doctor, words):
    assert_one_sentence(doctor('--system', *words), 2, 'are for a BAG')


@pytest.mark.parametrize('words', [(), ('--delete-stale',), ('bag', '--system')])
def test_a_bag_or_the_system_is_checked(doctor, words):
    assert_one_sentence(doctor(*words), 2, 'give either BAG, or --system')
