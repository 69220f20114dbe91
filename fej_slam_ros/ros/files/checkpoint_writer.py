# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writes the checkpoints of a live run by a thread: no disk can delay or end the run."""

from pathlib import Path
from threading import Event, Thread
from time import monotonic

from fej_slam_ros.errors import UserError
from fej_slam_ros.output_lock import InUseError, OutputLock
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.files.live_files import SLOW_AFTER


class CheckpointWriter:
    """The only writer of a checkpoint file; raises UserError if another process writes it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._failure = ''
        self._lock: OutputLock | None = None
        try:
            self._lock = OutputLock.of_file(path)
        except InUseError:
            raise
        except UserError as error:
            # The disk may be back before the checkpoint is due.
            self._failure = str(error)
        self._begun = monotonic()
        self._is_done = Event()
        self._is_done.set()

    @property
    def is_busy(self) -> bool:
        """Return whether a checkpoint is being written."""
        return not self._is_done.is_set()

    @property
    def error(self) -> str:
        """Return why the latest checkpoint is not written, '' if it is or soon will be."""
        duration = monotonic() - self._begun
        if not self._is_done.is_set() and duration > SLOW_AFTER:
            return f'{self.path} has been written for {duration:.0f} s and is not complete'
        return self._failure

    def begin(self, content: bytes) -> bool:
        """Begin to write a checkpoint; return False if another one is being written."""
        if self.is_busy:
            return False
        self._begun = monotonic()
        self._is_done.clear()
        # A process can end although a disk keeps its thread.
        Thread(target=self._write, args=(content,), name='checkpoint', daemon=True).start()
        return True

    def wait(self, timeout: float) -> str:
        """Wait for the end of writing, at most for a timeout [s]; return what is wrong, or ''."""
        if self._is_done.wait(timeout):
            return self._failure
        return f'{self.path} is not complete: it is still being written'

    def save(self, content: bytes, timeout: float) -> None:
        """Write a checkpoint; raise UserError if that fails or takes longer than a time [s]."""
        busy = self.wait(timeout)
        error = self.wait(timeout) if self.begin(content) else busy
        if error:
            raise UserError(error)

    def close(self) -> None:
        """Let other processes write the file."""
        if self._lock is not None:
            self._lock.release()

    def _write(self, content: bytes) -> None:
        try:
            if self._lock is None:
                self._lock = OutputLock.of_file(self.path)
            checkpoint.write(self.path, content)
            self._failure = ''
        except UserError as error:
            self._failure = str(error)
        self._is_done.set()
