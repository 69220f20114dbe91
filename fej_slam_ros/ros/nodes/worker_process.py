# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A worker process for long computations, which never blocks its parent.

It ends with the parent, and is replaced if it dies, hangs or raises an exception.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
import multiprocessing
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.reduction import ForkingPickler
import signal
from threading import Thread
from time import monotonic
import traceback
from typing import Any

from fej_slam_ros.child_process import described_exit, end_with_parent, processor_time

#: Delay [s] before the process is started again after it has died twice without a result; it
#: doubles with each further death up to the maximum. After the first death there is none.
RESTART_DELAY = 1.0
MAX_RESTART_DELAY = 60.0
#: Time [s] for a process that has closed its pipe to end.
EXIT_TIMEOUT = 1.0
#: Time [s] without processor time after which a process that has a task counts as hung.
HUNG_AFTER = 30.0
#: Number of processes in which a task may raise an exception before it is given up.
MAX_FAILURES = 3


@dataclass(frozen=True, slots=True, eq=False)
class FailedTask:
    """Result of a task that is given up."""

    reason: str  #: the exception that it raises
    argument: Any = None  #: of the function

    @property
    def error(self) -> str:
        """Return the reason as a sentence for users."""
        return f'its computation fails with {self.reason}'


class Request(Thread):
    """
    Sends a task and waits for the answer; both may take for ever if the process was stopped.

    Parameters
    ----------
    pipe : to the process
    task : pickled; empty to wait for the first answer, which the process gives when it is ready

    Attributes
    ----------
    answer : pickled, empty before it has arrived and if the process has died

    """

    def __init__(self, pipe: Connection, task: bytes | memoryview = b'') -> None:
        super().__init__(daemon=True)
        self._pipe, self._task = pipe, task
        self.answer = b''
        self.start()

    def run(self) -> None:
        """Send the task and receive the answer."""
        with suppress(EOFError, OSError):
            if self._task:
                self._pipe.send_bytes(self._task)
            self.answer = self._pipe.recv_bytes()


class Worker:
    """
    Calls functions in another process, one at a time.

    A thread would hold the interpreter lock, for which callbacks wait. If the process dies, or
    gets no processor time as one that was stopped, another one repeats the task. A task that
    raises an exception in several processes is given up.

    Attributes
    ----------
    deaths : number of processes that have died, or were killed because they hung or failed
    fault : how the last one died and what follows, '' after the next result

    """

    _request: Request
    _is_listening: bool  # whether the process is ready for tasks

    def __init__(self) -> None:
        # The function and the argument of the task in progress, None without any.
        self._task: tuple[Callable[[Any], Any], Any] | None = None
        self._unsuccessful = self._failures = self.deaths = 0
        self._restart_time = 0.0
        self.fault = ''
        self._start()

    @property
    def is_ready(self) -> bool:
        """Return whether the process can begin a task."""
        return self._is_listening and self._task is None

    def begin(self, function: Callable[[Any], Any], argument: Any) -> None:
        """Begin to call a function; no other task may be in progress."""
        self._task, self._failures = (function, argument), 0
        if self._is_listening:
            self._send_task()

    def result(self) -> Any:
        """
        Return the result of the task, None before that; replace the process if it has died.

        The result of a task that is given up is a `FailedTask`.

        """
        if self._pipe.closed:
            if monotonic() >= self._restart_time:
                self._start()
            return None
        if self._request.is_alive():
            if self._is_hung():
                self._replace(f'the worker process got no processor time for {HUNG_AFTER:g} s')
            return None
        if not self._request.answer:
            self._process.join(EXIT_TIMEOUT)
            self._replace(f'the worker process {described_exit(self._process.exitcode)}')
            return None
        if self.is_ready:
            return None
        result = ForkingPickler.loads(self._request.answer)
        if isinstance(result, FailedTask):
            return self._repeat_or_give_up(result.reason)
        if self._is_listening:
            self._task, self._unsuccessful, self.fault = None, 0, ''
            return result
        self._is_listening = True
        self._send_task()
        return None

    def close(self) -> None:
        """End the process, even during a task."""
        # SIGTERM would not end a stopped process.
        self._process.kill()
        self._process.join()
        self._request.join()
        self._pipe.close()

    def _start(self) -> None:
        # Spawned, not forked: a fork copies the locks that threads of this process hold.
        context = multiprocessing.get_context('spawn')
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), daemon=True)
        # The first child would start the tracker, which unblocks both signals, so it is started
        # before.
        resource_tracker.ensure_running()
        # The child inherits the mask: Ctrl-C, and the SIGTERM of systemd to all processes of a
        # service, end only this process, which then ends the child.
        before = signal.pthread_sigmask(
            signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self._is_listening = False
        self._processor_time, self._seen_working = 0.0, monotonic()
        self._request = Request(self._pipe)

    def _send_task(self) -> None:
        if self._task is not None:
            self._seen_working = monotonic()
            self._request = Request(self._pipe, ForkingPickler.dumps(self._task))

    def _is_hung(self) -> bool:
        """Return whether the process lives, but has used no processor time for long."""
        if self._process.pid is None or not self._process.is_alive():
            return False
        now, used = monotonic(), processor_time(self._process.pid)
        if used > self._processor_time:
            self._processor_time, self._seen_working = used, now
        return now - self._seen_working > HUNG_AFTER

    def _repeat_or_give_up(self, reason: str) -> FailedTask | None:
        """Let another process repeat a task that raises an exception; return it if given up."""
        death = f'the worker process failed with {reason}'
        self._failures += 1
        if self._failures < MAX_FAILURES:
            self._replace(death)
            return None
        task, self._task = self._task, None
        self._replace(death, 'the task is given up, another process starts')
        return FailedTask(reason, task and task[1])

    def _replace(self, death: str, what_follows: str = 'another one repeats the task') -> None:
        """Start another process; `death` is how this one ended, in words."""
        self.close()
        self.deaths += 1
        self._unsuccessful += 1
        self._is_listening = False
        delay = min(RESTART_DELAY * 2.0 ** (self._unsuccessful - 2), MAX_RESTART_DELAY)
        if self._unsuccessful == 1:
            delay = 0.0
        self._restart_time = monotonic() + delay
        self.fault = (
            death + (f', {self._unsuccessful} times in a row' if self._unsuccessful > 1 else '')
            + f': {what_follows}{f" in {delay:g} s" if delay else ""}')


def _work(pipe: Connection) -> None:
    end_with_parent()
    # The pipe closes with the parent, however that ends.
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        pipe.send(None)
        while True:
            pipe.send_bytes(_answer(pipe.recv_bytes()))


def _answer(task: bytes) -> bytes | memoryview:
    """Return the result of a task, or the exception that it raises; both are pickled."""
    try:
        function, argument = ForkingPickler.loads(task)
        return ForkingPickler.dumps(function(argument))
    # Also those of an error in the program: the parent goes on without the result.
    except Exception as error:  # noqa: BLE001
        traceback.print_exc()
        return ForkingPickler.dumps(FailedTask(f'{type(error).__name__}: {error}'))
