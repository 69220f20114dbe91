# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Worker processes: results in order, and an end with the process that they work for."""

import os
import select
import subprocess
import sys

import pytest

from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.common.executor import in_order, processes
from helpers.dying_workers import die_at_2, die_once, die_while_answering

#: A process that says who its workers are and then waits to be killed.
EMPLOYER = """
import os, signal
from fej_slam_ros.experiments.common.executor import in_order, processes
if __name__ == '__main__':
    with processes(2) as executor:
        print(*{executor.submit(os.getpid).result() for _ in range(20)}, flush=True)
        signal.pause()
"""


@pytest.mark.parametrize('jobs', [1, 2])
def test_results_come_in_the_order_of_the_tasks(jobs):
    with processes(jobs) as executor:
        assert list(in_order(executor, abs, range(-20, 0))) == list(range(20, 0, -1))


@pytest.mark.parametrize('jobs', [1, 2])
def test_only_the_task_of_a_killed_worker_is_repeated(jobs, tmp_path):
    tasks = [(k, tmp_path / str(k) if k in {1, 4} else None) for k in range(6)]

    with processes(jobs) as executor:
        results = list(in_order(executor, die_once, tasks))

        assert results == list(range(6))
        assert executor.deaths == 2


def test_a_task_that_kills_each_worker_ends_after_the_earlier_results_with_a_cure():
    finished = []

    with pytest.raises(UserError, match='3 times: check for too little'), processes(2) as executor:
        finished.extend(in_order(executor, die_at_2, range(5)))

    assert finished == [0, 1]


def test_a_worker_that_is_killed_while_it_answers_is_missed():
    with processes(1) as executor, pytest.raises(UserError, match='ended unexpectedly'):
        # Without an end the result would never come.
        executor.submit(die_while_answering).result(timeout=60.0)


def test_workers_end_with_a_parent_that_was_killed():
    with subprocess.Popen(
        [sys.executable, '-c', EMPLOYER], stdout=subprocess.PIPE, text=True,
        stderr=subprocess.DEVNULL,
    ) as employer:
        workers = [os.pidfd_open(int(pid)) for pid in employer.stdout.readline().split()]
        employer.kill()

    # A process's file descriptor is ready to read when it has ended.
    ended = [bool(select.select([worker], [], [], 60.0)[0]) for worker in workers]
    for worker in workers:
        os.close(worker)

    assert workers
    assert all(ended)
