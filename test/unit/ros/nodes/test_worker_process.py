# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A worker process does one task after the other; its end is detected."""

from contextlib import closing
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from helpers.dying_workers import die_once, end_of_file, fail_twice
from helpers.optional import optional
from helpers.processes import until

worker = optional('fej_slam_ros.ros.nodes.worker_process')

pytestmark = pytest.mark.ros

#: In an interpreter of its own, whose first worker it is: that starts a tracker of resources, too.
INTERRUPTED = """
import signal
from fej_slam_ros.ros.nodes.worker_process import Worker
doing = Worker()
while not doing.is_ready:
    doing.result()
doing.begin(signal.raise_signal, signal.{})
while not doing.is_ready:
    doing.result()
assert doing.deaths == 0
doing.close()
"""


def done(doing):
    """Return the result of what a worker does, when it has come."""
    found = []
    until(lambda: found or found.extend(filter(None, [doing.result()])), pause)
    return found[0]


def ready(doing):
    until(lambda: doing.result() is not None or doing.is_ready, pause)


def pause():
    time.sleep(0.01)  # between two looks at what another process does


def test_a_task_is_done_in_another_process():
    with closing(worker.Worker()) as doing:
        ready(doing)
        for n, expected in (5, 120), (6, 720):
            doing.begin(math.factorial, n)
            assert not doing.is_ready
            assert done(doing) == expected
            assert doing.is_ready


def test_another_process_repeats_the_task_of_one_that_died(tmp_path):
    with closing(worker.Worker()) as doing:
        ready(doing)
        doing.begin(die_once, (7, tmp_path / 'begun'))

        assert done(doing) == 7

        assert (doing.deaths, doing.fault) == (1, '')


def test_a_process_that_dies_without_a_task_is_replaced():
    with closing(worker.Worker()) as doing:
        ready(doing)
        child, = multiprocessing.active_children()
        os.kill(child.pid, signal.SIGKILL)
        child.join()

        # Nothing says in advance that the process has died.
        doing.begin(math.factorial, 5)

        assert done(doing) == 120
        assert doing.deaths == 1


def test_repeated_deaths_are_described_and_delay_the_restart(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(worker, 'monotonic', lambda: now[0])
    faults = []
    with closing(worker.Worker()) as doing:
        ready(doing)
        doing.begin(os._exit, 3)
        while doing.deaths < 4:
            before = doing.deaths
            until(lambda before=before: doing.result() or doing.deaths > before, pause)
            faults.append(doing.fault)
            deaths = doing.deaths
            for _ in range(20):
                assert doing.result() is None
            now[0] += 4.0

    assert deaths == 4
    assert faults == [
        'the worker process ended with status 3: another one repeats the task',
        *(f'the worker process ended with status 3, {k} times in a row: another one repeats the'
          f' task in {delay} s' for k, delay in ((2, 1), (3, 2), (4, 4)))]


@pytest.fixture
def at_once(monkeypatch):
    """Let processes start again without a delay."""
    monkeypatch.setattr(worker, 'RESTART_DELAY', 0.0)


@pytest.mark.usefixtures('at_once')
def test_a_task_that_raises_exceptions_by_chance_is_repeated(tmp_path):
    with closing(worker.Worker()) as doing:
        ready(doing)
        doing.begin(fail_twice, tmp_path)

        assert done(doing) == 2

        assert (doing.deaths, doing.fault) == (2, '')


@pytest.mark.usefixtures('at_once')
@pytest.mark.parametrize(('function', 'argument', 'reason'), [
    (math.sqrt, -1.0, 'ValueError: math domain error'), (end_of_file, 0, 'EOFError: too short')])
def test_a_task_that_always_raises_an_exception_is_given_up_and_the_next_one_is_done(
    function, argument, reason
):
    with closing(worker.Worker()) as doing:
        ready(doing)
        doing.begin(function, argument)

        failed = done(doing)

        assert isinstance(failed, worker.FailedTask)
        assert (failed.argument, failed.error) == (
            argument, f'its computation fails with {reason}')
        assert doing.deaths == 3
        assert doing.fault == (
            f'the worker process failed with {reason}, 3 times in a row: the task is given up,'
            ' another process starts')
        doing.begin(math.factorial, 5)
        assert done(doing) == 120
        assert (doing.deaths, doing.fault) == (3, '')


def test_a_computing_process_ends_on_close():
    doing = worker.Worker()
    ready(doing)
    doing.begin(time.sleep, 1000.0)

    doing.close()  # waits for its end


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM'])
def test_signals_to_all_processes_do_not_reach_the_first_worker_either(name):
    subprocess.run([sys.executable, '-c', INTERRUPTED.format(name)], check=True, timeout=60)


@pytest.mark.parametrize('size', [1, 10_000_000], ids=['small', 'larger than the pipe'])
def test_a_stopped_process_is_replaced_without_blocking_its_parent(monkeypatch, size):
    """A process under SIGSTOP neither takes tasks nor ends on SIGTERM."""
    now = [0.0]
    monkeypatch.setattr(worker, 'monotonic', lambda: now[0])
    with closing(worker.Worker()) as doing:
        ready(doing)
        child, = multiprocessing.active_children()
        os.kill(child.pid, signal.SIGSTOP)

        doing.begin(len, size * b' ')
        before = doing.result(), doing.deaths
        now[0] += worker.HUNG_AFTER + 1.0
        fault = (doing.result(), doing.fault)[1]

        assert (before, doing.deaths) == ((None, 0), 1)
        assert fault == (
            'the worker process got no processor time for 30 s: another one repeats the task')
        assert done(doing) == size
