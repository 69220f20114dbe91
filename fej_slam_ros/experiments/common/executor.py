# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Worker processes of this machine for Monte Carlo runs, as a `concurrent.futures` executor.

Those of a Dask cluster are in :mod:`fej_slam_ros.experiments.common.cluster`.
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
    """Provide worker processes that end with this one, even if it is killed."""
    # Spawned, not forked: a fork copies locks that other threads hold.
    context = multiprocessing.get_context('spawn')
    executor = ProcessPoolExecutor(jobs, context, initializer=_end_with_parent)
    try:
        yield executor
    except BrokenProcessPool as error:
        raise UserError(
            'a worker process has ended unexpectedly: check for too little memory, and run fewer'
            ' jobs at a time') from error
    except KeyboardInterrupt:
        # Running tasks are discarded; they may take minutes.
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
    """End this worker if its parent ends without ending it."""
    def wait() -> None:
        cast(BaseProcess, multiprocessing.parent_process()).join()
        os._exit(1)

    Thread(target=wait, daemon=True).start()
