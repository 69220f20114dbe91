# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A full, read-only, removed or slow disk neither stops nor delays a live run, and is reported."""

import json
import shutil
import signal

import pytest

from helpers.disks import Disk, why_none
from helpers.optional import optional
from helpers.ros import csv_rows, meeting, raw_record, write_parameters

live_helpers = optional('helpers.live')
services = optional('std_srvs.srv')

pytestmark = [
    pytest.mark.ros, pytest.mark.slow,
    pytest.mark.skipif(why_none() is not None, reason=str(why_none()))]

ROBOTS = ['r1', 'r2']
STEPS = 60
#: Number of steps that are processed before the input ends: the last one waits for the next.
PUBLISHED = STEPS - 2


class Run:
    """An estimator or smoother that writes to a disk, with input in two halves."""

    def __init__(self, domain, folder, verb='estimator', **values):
        self.domain, self.verb = domain, verb
        self.given = write_parameters(folder / 'team.yaml', **{
            'robots': ROBOTS, 'stale_after': 60.0, **live_helpers.reliable_inputs(ROBOTS),
            **values})
        self.process = domain.start(verb, '--ros-args', '--params-file', self.given)
        self.poses = domain.listen('r1/pose', live_helpers.POSE)
        self.reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
        domain.until(lambda: self.reports)
        records = [raw_record(record) for record in meeting(STEPS)]
        middle = len(records) // 2
        self.halves = records[:middle], records[middle:]
        domain.send(*self.halves[0])
        domain.until(lambda: len(self.poses) >= STEPS // 2 - 2)

    def go_on(self):
        """Send the other half; return when all poses of the run but the last are published."""
        self.domain.send(*self.halves[1])
        self.domain.until(lambda: len(self.poses) >= PUBLISHED)

    def files(self):
        """Return level and sentence of the status of files in the newest report."""
        name = f'{self.verb}: files'
        return next(
            (s.level, s.message) for s in self.reports[-1].status if s.name == name)

    def until_reported(self, *parts, meanwhile=lambda: None):
        def is_reported():
            meanwhile()
            return self.files()[0] == 2 and all(part in self.files()[1] for part in parts)

        self.domain.until(is_reported)

    def ask(self, service):
        return self.domain.ask(f'/{self.verb}/{service}', services.Trigger)

    def end(self):
        """End the node; return its status, the lines of its log and its last line."""
        status, errors = self.domain.finish(self.process, signal.SIGINT)
        assert 'Traceback' not in errors, errors
        lines = errors.splitlines()
        return status, lines, lines[-1]


@pytest.fixture
def disk(tmp_path):
    with Disk(tmp_path) as disk:
        yield disk


def test_on_a_full_disk_the_run_goes_on_and_everybody_is_told(domain, tmp_path, disk):
    out, saved = disk.path / 'out', disk.path / 'run.checkpoint'
    run = Run(domain, tmp_path, output=str(out), checkpoint=str(saved), autosave_period=0.2)
    domain.until(saved.exists)
    before = saved.read_bytes()

    disk.fill()
    run.go_on()
    # A checkpoint that replaces another one frees its space.
    run.until_reported(
        str(out), str(saved), 'No space left on device', 'free space there', meanwhile=disk.fill)

    answer = run.ask('save')
    assert (answer.success, 'No space left' in answer.message) == (False, True)
    answer = run.ask('reset')
    assert not answer.success
    assert 'a new run begins with the next input, but' in answer.message
    assert 'not complete' in answer.message
    poses = len(run.poses)
    domain.send(*run.halves[0])
    domain.until(lambda: len(run.poses) >= poses + STEPS // 2 - 2)
    status, lines, last = run.end()
    assert status == 1
    assert 'files are not complete' in last
    assert 'No space left on device' in last
    assert sum('the run goes on' in line for line in lines) <= 4
    assert before[:30] == saved.read_bytes()[:30]
    assert not (out / 'trajectory_r1.csv').exists()


def test_what_a_full_disk_refused_is_written_when_there_is_space_again(domain, tmp_path, disk):
    out = disk.path / 'out'
    run = Run(domain, tmp_path, output=str(out))

    disk.fill()
    run.go_on()
    run.until_reported('No space left on device')
    disk.free()
    domain.until(lambda: run.files() == (0, 'no error'))

    status, lines, last = run.end()
    assert status == 0
    assert sum("the files of 'output' are written again" in line for line in lines) == 1
    assert f'files are in {out}' in last
    assert len(csv_rows(out / 'trajectory_r1.csv')) == STEPS
    assert {path.name for path in out.iterdir()} == {
        'landmarks.csv', 'r1.tum', 'r2.tum', 'summary.json', 'trajectory_r1.csv',
        'trajectory_r2.csv'}


@pytest.mark.parametrize('verb', ['estimator', 'smoother'])
@pytest.mark.parametrize(('fault', 'reason'), [
    ('make_read_only', 'Read-only file system'), ('unmount', 'No such file or directory'),
    ('remove', 'No such file or directory')])
def test_a_disk_that_becomes_read_only_or_is_removed_is_an_error_with_its_reason(
    domain, tmp_path, disk, verb, fault, reason,
):
    out = disk.path / 'out'
    run = Run(domain, tmp_path, verb, output=str(out))

    if fault == 'remove':
        shutil.rmtree(out)
    else:
        getattr(disk, fault)()
    run.go_on()
    run.until_reported(str(out), reason)

    status, _, last = run.end()
    assert status == 1
    assert reason in last
    assert 'not complete: trajectory_r1.csv, r1.tum' in last


def test_a_disk_that_takes_nothing_delays_no_pose_and_no_answer(domain, tmp_path, disk):
    out, saved = disk.path / 'out', disk.path / 'run.checkpoint'
    run = Run(domain, tmp_path, output=str(out), checkpoint=str(saved))

    disk.freeze()
    run.go_on()
    run.until_reported(f'{out} takes no data for')

    answer = run.ask('save')
    assert not answer.success
    assert answer.message == f'{saved} is not complete: it is still being written'
    disk.thaw()
    domain.until(lambda: run.files() == (0, 'no error'))
    assert run.ask('save').success
    status, _, last = run.end()
    assert (status, f'files are in {out}' in last) == (0, True)
    assert len(csv_rows(out / 'trajectory_r1.csv')) == STEPS
    assert json.loads((out / 'summary.json').read_text())['state_hash']
