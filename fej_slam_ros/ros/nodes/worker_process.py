# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A worker process for long computations; it ends with its parent and is replaced if it dies."""

from collections.abc import Callable
from contextlib import suppress
import multiprocessing
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
import signal
from time import monotonic
from typing import Any, Generic, TypeVar

from fej_slam_ros.worker_exit import described_exit, end_with_parent

TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')

#: Delay [s] before the process is started again after it has died twice without a result; it
#: doubles with each further death up to the maximum. After the first death there is none.
RESTART_DELAY = 1.0
MAX_RESTART_DELAY = 60.0
#: Time [s] for a process that has closed its pipe to end.
EXIT_TIMEOUT = 1.0


class Worker(Generic[TaskT, ResultT]):
    """
    Calls a function in another process, for one task at a time.

    A thread would hold the interpreter lock, for which callbacks wait. If the process dies,
    another one repeats the task.

    Parameters
    ----------
    function : called with each task

    Attributes
    ----------
    deaths : number of processes that have died
    fault : how the last one died and what follows, '' after the next result

    """

    def __init__(self, function: Callable[[TaskT], ResultT]) -> None:
        self._function = function
        self._tasks: list[TaskT] = []
        self._unsuccessful = self.deaths = 0
        self._restart_time = 0.0
        self._is_listening = False
        self.fault = ''
        self._start()

    @property
    def is_ready(self) -> bool:
        """Return whether the process can begin a task."""
        return self._is_listening and not self._tasks

    def begin(self, task: TaskT) -> None:
        """Begin a task; the process must be ready."""
        self._tasks = [task]
        self._send_task()

    def result(self) -> ResultT | None:
        """Return the result of the task, None before that; replace the process if it has died."""
        if self._pipe.closed:
            if monotonic() >= self._restart_time:
                self._start()
            return None
        try:
            if not self._pipe.poll():
                return None
            result: ResultT | None = self._pipe.recv()
        except (EOFError, OSError):
            self._note_death()
            return None
        if self._is_listening:
            self._tasks.clear()
            self._unsuccessful, self.fault = 0, ''
            return result
        self._is_listening = True
        self._send_task()
        return None

    def close(self) -> None:
        """End the process, even during a task."""
        self._pipe.close()
        self._process.terminate()
        self._process.join()

    def _start(self) -> None:
        # Spawned, not forked: a fork copies the locks that threads of this process hold.
        context = multiprocessing.get_context('spawn')
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._function), daemon=True)
        # The first child would start the tracker, which unblocks SIGINT, so it is started before.
        resource_tracker.ensure_running()
        # The child inherits the mask: Ctrl-C reaches only this process, which then ends the child.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self._is_listening = False

    def _send_task(self) -> None:
        # That the process has died is noticed when its result is read.
        with suppress(OSError):
            for task in self._tasks:
                self._pipe.send(task)

    def _note_death(self) -> None:
        self._pipe.close()
        self._process.join(EXIT_TIMEOUT)
        status = self._process.exitcode
        self._process.kill()
        self.deaths += 1
        self._unsuccessful += 1
        self._is_listening = False
        delay = min(RESTART_DELAY * 2.0 ** (self._unsuccessful - 2), MAX_RESTART_DELAY)
        if self._unsuccessful == 1:
            delay = 0.0
        self._restart_time = monotonic() + delay
        self.fault = (
            f'the worker process {described_exit(status)}'
            + (f', {self._unsuccessful} times in a row' if self._unsuccessful > 1 else '')
            + f': another one repeats the task{f" in {delay:g} s" if delay else ""}')


def _work(pipe: Connection, function: Callable[[Any], Any]) -> None:
    end_with_parent()
    # The pipe closes with the parent, however that ends.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send(None)
        while True:
            pipe.send(function(pipe.recv()))
