# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A process that solves beside the callbacks, and ends with the one that started it."""

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

    A thread would not do: while it computes, callbacks wait for the interpreter.

    Parameters
    ----------
    function : what is called with each task

    Attributes
    ----------
    is_ready : whether it can be given a task

    """

    def __init__(self, function: Callable[[TaskT], ResultT]) -> None:
        # Spawned, not forked: a fork copies the locks of whatever threads this process has.
        context = multiprocessing.get_context('spawn')
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, function), daemon=True)
        # When this starts, which the first process would have it do, it unblocks the signal.
        resource_tracker.ensure_running()
        # The process inherits the mask: Ctrl-C is for this one, which then ends the other.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.is_ready = False

    def begin(self, task: TaskT) -> None:
        """Give it a task, when it is ready."""
        self.is_ready = False
        self._pipe.send(task)

    def result(self) -> ResultT | None:
        """
        Return the result of the task if it has come, else None.

        Raises
        ------
        EOFError
            The process has ended.

        """
        if self.is_ready or not self._pipe.poll():
            return None
        result: ResultT | None = self._pipe.recv()
        self.is_ready = True
        return result

    def close(self) -> None:
        """End the process, whatever it does."""
        self._pipe.close()
        self._process.terminate()
        self._process.join()


def _work(pipe: Connection, function: Callable[[Any], Any]) -> None:
    # The pipe ends with the other process, whatever ends that.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send(None)
        while True:
            pipe.send(function(pipe.recv()))
