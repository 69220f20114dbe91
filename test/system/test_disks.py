# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on a full or read-only disk end with one sentence; two never share an output."""

import os
from pathlib import Path
import signal

import pytest

from helpers.disks import Disk, why_none
from helpers.paths import BAGS
from helpers.processes import end_session, start_verb, until
from helpers.ros import run_verb, summary_of

needs_disk = pytest.mark.skipif(why_none() is not None, reason=str(why_none()))
pytestmark = pytest.mark.slow

BAG = BAGS / 'two_circles'
PARAMETERS = BAG.with_suffix('.yaml')
READ = BAG, '--params', PARAMETERS
#: Words of each command, with the path on the disk last.
COMMANDS = {
    'replay': ['replay', *READ, '--bag', '--output'],
    'smooth': ['smooth', *READ, '--bag', '--output'],
    'simulate': ['simulate', '--output'],
    'simulate to sqlite3': ['simulate', '--storage', 'sqlite3', '--output'],
    'reproduce': ['reproduce', 'observability', '--output'],
    'calibrate': ['calibrate', *READ, '--from', 'truth', '--output'],
    'doctor': ['doctor', BAG, '--json'],
    'demo': ['demo', '--output']}
#: Commands whose files need more than some kilobytes.
LARGE = ['replay', 'smooth', 'simulate', 'simulate to sqlite3']


@pytest.fixture
def disk(tmp_path):
    with Disk(tmp_path) as disk:
        yield disk


def ended(words, **options):
    """Run a command as a process; return its status, its output and its errors."""
    process = start_verb(*words, **options)
    try:
        output, errors = process.communicate(timeout=120.0)
    finally:
        end_session(process)
    return process.returncode, output, errors


def left_on(disk):
    return {
        path.name for path in disk.path.rglob('*')
        if not path.is_dir() and path.name != 'filler'}


def assert_refused(result, disk, reason):
    status, _, errors = result
    assert status == 1
    assert errors.count('\n') == 1
    assert ': cannot write ' in errors
    assert f'{reason}: ' in errors
    assert not left_on(disk)


@needs_disk
@pytest.mark.parametrize('command', COMMANDS)
@pytest.mark.parametrize(('fault', 'reason'), [
    ('fill', 'No space left on device'), ('make_read_only', 'Read-only file system')])
def test_on_a_disk_that_takes_nothing_a_command_says_why_in_one_sentence(
    disk, command, fault, reason,
):
    getattr(disk, fault)()

    result = ended([*COMMANDS[command], disk.path / 'out'])

    assert_refused(result, disk, reason)


@needs_disk
@pytest.mark.parametrize('command', LARGE)
def test_a_disk_that_becomes_full_ends_a_command_without_partial_files(disk, command):
    disk.fill()
    disk.leave(20_000)

    result = ended([*COMMANDS[command], disk.path / 'out'])

    assert_refused(result, disk, 'full' if 'sqlite3' in command else 'No space left on device')


@needs_disk
def test_a_full_disk_below_the_standard_output_is_one_sentence():
    with Path('/dev/full').open('w', encoding='utf-8') as full:
        status, _, errors = ended(['doctor', BAG], stdout=full)

    assert (status, errors.count('\n')) == (1, 1)
    assert 'cannot write to the standard output' in errors


@pytest.mark.parametrize(('command', 'remains'), [
    ('replay', 'out/trajectory_r1.csv.part'), ('smooth', 'out/trajectory_r1.csv.part'),
    ('simulate', '.out.partial'), ('calibrate', '.out.lock')])
def test_a_second_command_is_refused_and_after_a_kill_the_next_one_ends_clean(
    tmp_path, command, remains,
):
    words = [*COMMANDS[command], tmp_path / 'out']
    first = start_verb(*words)
    try:
        # A lock exists before it names its process.
        until(lambda: (tmp_path / remains).exists() and (
            remains != '.out.lock' or (tmp_path / remains).stat().st_size), lambda: None)
        os.kill(first.pid, signal.SIGSTOP)
        second = ended(words)
    finally:
        end_session(first)

    status, _, errors = second
    assert (status, errors.count('\n')) == (1, 1)
    assert f'{tmp_path / "out"} is in use by process {first.pid} on ' in errors
    assert (tmp_path / remains).exists()

    assert ended(words)[0] == 0
    assert not [path for path in tmp_path.rglob('*') if path.suffix in {'.part', '.lock'}]
    assert not (tmp_path / '.out.partial').exists()


def test_two_commands_at_once_write_one_result(tmp_path):
    words = [*COMMANDS['replay'], tmp_path / 'out']
    both = [start_verb(*words), start_verb(*words)]

    results = [(process.communicate()[1], process.returncode) for process in both]

    assert sorted(status for _, status in results) in ([0, 1], [0, 2])
    (errors,) = (errors for errors, status in results if status)
    assert 'is in use by' in errors or 'exists' in errors
    assert run_verb('replay', *READ, '--output', tmp_path / 'alone') == 0
    assert summary_of(tmp_path / 'out')['state_hash'] == summary_of(
        tmp_path / 'alone')['state_hash']
