# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Worker processes of this machine for Monte Carlo runs, as a `concurrent.futures` executor.

Those of a Dask cluster are in :mod:`fej_slam_ros.experiments.common.cluster`.
"""

from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
import multiprocessing
from multiprocessing import resource_tracker
import signal
from threading import local, Lock
from typing import Any, TypeVar

from fej_slam_ros.child_process import end_with_parent
from fej_slam_ros.errors import UserError
from fej_slam_ros.interrupts import INTERRUPTS, postponed

#: Number of worker processes that may end during the same run before it is given up.
MAX_ATTEMPTS = 3
TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')


class WorkerProcesses(ThreadPoolExecutor):
    """
    An executor of threads that each pass their tasks to a process of their own.

    So the task is known during which a process ended, and only this one is repeated.

    Attributes
    ----------
    deaths : number of processes that ended during a task

    """

    def __init__(self, jobs: int) -> None:
        super().__init__(jobs)
        self.deaths = 0
        self._lock, self._of_thread, self._is_stopped = Lock(), local(), False
        self._pools: list[ProcessPoolExecutor] = []
        # The first process would start the tracker, which unblocks signals.
        resource_tracker.ensure_running()

    def submit(
        self, function: Callable[..., ResultT], /, *args: Any, **kwargs: Any
    ) -> 'Future[ResultT]':
        """Request a call in a process; its result is a `UserError` if processes keep ending."""
        return super().submit(self._call, function, *args, **kwargs)

    def stop(self) -> None:
        """End the processes and their tasks, which may take minutes."""
        with self._lock:
            self._is_stopped = True
        for worker in multiprocessing.active_children():
            worker.kill()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads, and the processes after their present tasks."""
        super().shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait)

    def _call(self, function: Callable[..., ResultT], *args: Any, **kwargs: Any) -> ResultT:
        for _ in range(MAX_ATTEMPTS):
            with suppress(BrokenProcessPool):
                return self._begin(function, *args, **kwargs).result()
            with self._lock:
                del self._of_thread.pool
                self.deaths += 1
        raise UserError(
            f'the worker process of a run has ended unexpectedly {MAX_ATTEMPTS} times: check for'
            ' too little memory, and run fewer jobs at a time')

    def _begin(
        self, function: Callable[..., ResultT], *args: Any, **kwargs: Any
    ) -> 'Future[ResultT]':
        with self._lock:
            if self._is_stopped:
                raise CancelledError
            is_new = not hasattr(self._of_thread, 'pool')
            if is_new:
                self._of_thread.pool = _pool()
                self._pools.append(self._of_thread.pool)
            pool: ProcessPoolExecutor = self._of_thread.pool
            submitted = pool.submit(function, *args, **kwargs)
            if is_new:
                # Only the process writes results. This end would keep the pool waiting for the
                # rest of a result during which the process is killed.
                pool._result_queue._writer.close()  # type: ignore[attr-defined]  # noqa: SLF001
            return submitted


@contextmanager
def processes(jobs: int) -> Iterator[WorkerProcesses]:
    """Provide worker processes that end with this one, even if it is killed."""
    executor = WorkerProcesses(jobs)
    try:
        yield executor
    except BaseException:
        # Results of running tasks are of no use any more.
        executor.stop()
        raise
    finally:
        executor.shutdown(cancel_futures=True)


def in_order(
    executor: Executor, function: Callable[[TaskT], ResultT], tasks: Iterable[TaskT]
) -> Generator[ResultT, None, None]:
    """Yield results in the order of the tasks; closing it drops the tasks that have not begun."""
    # Workers inherit the mask: an interrupt reaches this process only, which then ends them. Its
    # handler may still be called, after another thread has received it, but not while `map` holds
    # locks that the end needs.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, INTERRUPTS)
    try:
        with postponed():
            results = executor.map(function, tasks)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    yield from results


def _pool() -> ProcessPoolExecutor:
    # Spawned, not forked: a fork copies locks that other threads hold.
    context = multiprocessing.get_context('spawn')
    return ProcessPoolExecutor(1, context, initializer=end_with_parent)
