# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Where Monte Carlo runs are made: processes of this machine, or a Dask cluster.

Both are executors in the sense of :mod:`concurrent.futures`.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
import multiprocessing
import os
import signal
from threading import Thread
from typing import TypeVar

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
    finally:
        executor.shutdown(cancel_futures=True)


@contextmanager
def dask(address: str) -> Iterator[Executor]:
    """Provide the workers of the Dask scheduler at an address."""
    from distributed import Client  # An extra, which takes a second to import.

    try:
        client = Client(address, timeout=10)
    except (OSError, ValueError) as error:
        raise UserError(f'no Dask scheduler answers at {address}: {error}') from error
    with client, client.get_executor() as executor:
        yield executor


def in_order(
    executor: Executor, function: Callable[[TaskT], ResultT], tasks: Iterable[TaskT]
) -> Iterator[ResultT]:
    """Return results in the order of the tasks; what is not begun is dropped with the iterator."""
    # Workers inherit the mask: an interrupt reaches this process only, which then ends them.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTS)
    try:
        return executor.map(function, tasks)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """End this worker when its parent has ended without ending it."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()
