# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A full, read-only, removed or slow disk neither stops nor delays a live run, and is reported."""

from contextlib import closing
import shutil
import signal

import pytest

from fej_slam_ros.core.peers.team_logs import LogContents
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files.exchange_file import ExchangeFile
from fej_slam_ros.ros.session.estimator_session import EstimatorSession
from helpers.disks import Disk, why_none
from helpers.optional import optional
from helpers.processes import end_session, until
from helpers.ros import csv_rows, drive, meeting, raw_record, summary_of, write_parameters

live_helpers = optional('helpers.live')
services = optional('std_srvs.srv')

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROBOTS = ['r1', 'r2']
STEPS = 60
#: Delay up to which the order of arrival does not matter [s], and the number of steps that wait.
MAX_DELAY = 1.0
WAITING = 11
PUBLISHED = STEPS - WAITING


class Run:
    """An estimator or smoother that writes to a disk, with input in two halves."""

    def __init__(self, domain, folder, verb='estimator', **values):
        self.domain, self.verb = domain, verb
        self.given = write_parameters(folder / 'team.yaml', **{
            'robots': ROBOTS, 'stale_after': 60.0, 'max_delay': MAX_DELAY,
            **live_helpers.reliable_inputs(ROBOTS), **values})
        self.process = domain.start(verb, '--ros-args', '--params-file', self.given)
        self.poses = domain.listen('r1/pose', live_helpers.POSE)
        self.reports = domain.listen('/diagnostics', live_helpers.DIAGNOSTICS)
        domain.until(lambda: self.reports)
        robots = values.get('robots', ROBOTS)
        records = [raw_record(record) for record in meeting(STEPS) if record.robot in robots]
        middle = len(records) // 2
        self.halves = records[:middle], records[middle:]
        # A topic that the node discovers after the others would be late in a burst; the records of
        # less than the delay are not.
        early = [record for record in records[:middle] if record.received < MAX_DELAY * 1e9]
        domain.send(*early)
        domain.until(lambda: sum(self.received()) == len(early))
        domain.send(*records[len(early):middle])
        domain.until(lambda: len(self.poses) >= STEPS // 2 - WAITING)

    def received(self):
        """Return the numbers of records of the robots in the newest report."""
        return [
            int(value.value) for status in self.reports[-1].status for value in status.values
            if value.key == 'received']

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


def undisturbed(given):
    """Return the state hash of a run in this process that writes nothing."""
    session = EstimatorSession(parameters.load(given, ['estimator']), None)
    drive(session, map(raw_record, meeting(STEPS)))
    return session.estimator.state_hash()


@pytest.fixture
def disk(tmp_path):
    if why_none() is not None:
        pytest.skip(why_none())
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
    domain.until(lambda: len(run.poses) >= poses + STEPS // 2 - WAITING)
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
    assert summary_of(out)['state_hash'] == undisturbed(run.given)
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
    assert summary_of(out)['state_hash'] == undisturbed(run.given)


def measurements_in(path):
    """Return the measurements of r1 in a file of the exchange."""
    with closing(ExchangeFile(path, 'r1')) as file:
        _, *blocks = (block.content for block in file.blocks)
    return LogContents('r1', blocks, ()).measurements()


def test_a_disk_that_takes_nothing_of_an_exchange_file_delays_no_pose_and_no_reset(
    domain, tmp_path, disk
):
    path = disk.path / 'r1.exchange'
    run = Run(
        domain, tmp_path, 'smoother', robots=['r1'], peers=['r2'], exchange_file=str(path))

    disk.freeze()
    run.go_on()
    run.until_reported(f'{path} takes no data for', 'blocks wait in memory')

    assert run.ask('reset').success
    disk.thaw()
    domain.until(lambda: run.files() == (0, 'no error'))
    status, lines, last = run.end()
    assert (status, 'files are not complete' in last) == (0, False)
    assert sum('the run goes on' in line for line in lines) == 1
    assert len(measurements_in(path)) == sum(map(len, run.halves))


@pytest.mark.parametrize(('fault', 'reason'), [
    ('fill', 'No space left on device'), ('make_read_only', 'Read-only file system'),
    ('unmount', 'No such file or directory')])
def test_an_exchange_file_that_cannot_be_written_is_an_error_also_at_the_end(
    domain, tmp_path, disk, fault, reason
):
    path = disk.path / 'r1.exchange'
    run = Run(
        domain, tmp_path, 'smoother', robots=['r1'], peers=['r2'], exchange_file=str(path))

    getattr(disk, fault)()
    run.go_on()
    run.until_reported(str(path), reason, 'blocks wait in memory')

    status, _, last = run.end()
    assert status == 1
    assert f'files are not complete: cannot write {path}: {reason}' in last
    assert 'blocks are missing in' in last


def test_a_reset_while_the_disk_takes_nothing_begins_a_run_without_files(domain, tmp_path, disk):
    out = disk.path / 'out'
    run = Run(domain, tmp_path, output=str(out))

    disk.freeze()
    answer = run.ask('reset')
    poses = len(run.poses)
    domain.send(*run.halves[0])
    domain.until(lambda: len(run.poses) >= poses + STEPS // 2 - WAITING)
    disk.thaw()

    assert not answer.success
    assert f'{out} is not complete: it is still being written' in answer.message
    assert f'cannot write to {out}_2: its disk takes no data' in answer.message
    status, _, last = run.end()
    assert (status, f'cannot write to {out}_2' in last) == (1, True)
    assert len(csv_rows(out / 'trajectory_r1.csv')) >= STEPS // 2


@pytest.mark.parametrize('name', ['output', 'checkpoint'])
def test_a_second_node_with_the_same_file_is_refused_in_one_sentence(domain, tmp_path, name):
    shared = {name: str(tmp_path / 'shared')}
    run = Run(domain, tmp_path, **shared)

    status, errors = domain.finish(domain.start(
        'estimator', '--ros-args', '--params-file', run.given, '-r', '__node:=other'))

    assert status == 1
    assert errors.splitlines()[-1].startswith(
        f'python3 -m fej_slam_ros estimator: {tmp_path / "shared"} is in use by process'
        f' {run.process.pid} on ')
    assert 'Traceback' not in errors
    run.go_on()
    assert run.end()[0] == 0


def test_a_killed_node_leaves_nothing_that_hinders_the_next_one(domain, tmp_path):
    values = {
        'output': str(tmp_path / 'out'), 'checkpoint': str(tmp_path / 'saved'),
        'autosave_period': 0.01}
    first = Run(domain, tmp_path, **values)
    until((tmp_path / 'saved.part').exists, lambda: None)
    end_session(first.process)
    assert (tmp_path / 'out' / 'trajectory_r1.csv.part').exists()
    domain.until(lambda: not domain.node.count_publishers('/r1/pose'))

    run = Run(domain, tmp_path, **values)
    run.go_on()

    status, lines, _ = run.end()
    assert status == 0
    assert any(
        f'the incomplete files in {tmp_path / "out"}, of process {first.process.pid} on' in line
        and line.endswith('are replaced') for line in lines)
    assert len(csv_rows(tmp_path / 'out' / 'trajectory_r1.csv')) == STEPS
    hidden = [path.name for path in tmp_path.rglob('.*')]
    assert not [*hidden, *tmp_path.rglob('*.part')]
