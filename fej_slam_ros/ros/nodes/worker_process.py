# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A worker process for long computations, which ends with its parent."""

from collections.abc import Callable
from contextlib import suppress
import multiprocessing
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
import signal
from typing import Any, Generic, TypeVar

TaskT = TypeVar('TaskT')
ResultT = TypeVar('ResultT')


class Worker(Generic[TaskT, ResultT]):
    """
    Calls a function in another process, for one task at a time.

    A thread would hold the interpreter lock, for which callbacks wait.

    Parameters
    ----------
    function : called with each task

    Attributes
    ----------
    is_ready : whether the process can begin a task

    """

    def __init__(self, function: Callable[[TaskT], ResultT]) -> None:
        # Spawned, not forked: a fork copies the locks that threads of this process hold.
        context = multiprocessing.get_context('spawn')
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, function), daemon=True)
        # The first child would start the tracker, which unblocks SIGINT, so it is started before.
        resource_tracker.ensure_running()
        # The child inherits the mask: Ctrl-C reaches only this process, which then ends the child.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.is_ready = False

    def begin(self, task: TaskT) -> None:
        """Begin a task; the process must be ready."""
        self.is_ready = False
        self._pipe.send(task)

    def result(self) -> ResultT | None:
        """Return the result of the task, None before that; EOFError if the process has ended."""
        if self.is_ready or not self._pipe.poll():
            return None
        result: ResultT | None = self._pipe.recv()
        self.is_ready = True
        return result

    def close(self) -> None:
        """End the process, even during a task."""
        self._pipe.close()
        self._process.terminate()
        self._process.join()


def _work(pipe: Connection, function: Callable[[Any], Any]) -> None:
    # The pipe closes with the parent, however that ends.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send(None)
        while True:
            pipe.send(function(pipe.recv()))
