# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Where Monte Carlo runs are made: by an executor in the sense of :mod:`concurrent.futures`.

Here the worker processes of this machine; those of a Dask cluster are in
:mod:`fej_slam_ros.experiments.common.cluster`.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
from multiprocessing.process import BaseProcess
import os
import signal
from threading import Thread
from typing import cast, TypeVar

from fej_slam_ros.errors import UserError

INTERRUPTS = {signal.SIGINT, signal.SIGTERM}

TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')


@contextmanager
def processes(jobs: int) -> Iterator[Executor]:
    """Provide worker processes that end with this one, whatever ends it."""
    # Spawned, not forked: a fork copies the locks of whatever threads this process has.
    context = multiprocessing.get_context('spawn')
    executor = ProcessPoolExecutor(jobs, context, initializer=_end_with_parent)
    try:
        yield executor
    except BrokenProcessPool as error:
        raise UserError(
            'a worker process has ended unexpectedly: look for too little memory, and use fewer'
            ' --jobs') from error
    except KeyboardInterrupt:
        # What they are making nobody will have; it may take minutes.
        for worker in multiprocessing.active_children():
            worker.kill()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def in_order(
    executor: Executor, function: Callable[[TaskT], ResultT], tasks: Iterable[TaskT]
) -> Generator[ResultT, None, None]:
    """Yield results in the order of the tasks; closing it drops the tasks that have not begun."""
    # Workers inherit the mask: an interrupt reaches this process only, which then ends them.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTS)
    try:
        results = executor.map(function, tasks)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    yield from results


def _end_with_parent() -> None:
    """Let this worker end when its parent has ended without ending it."""
    Thread(target=_await_parents_end, daemon=True).start()


def _await_parents_end() -> None:
    cast(BaseProcess, multiprocessing.parent_process()).join()
    os._exit(1)
