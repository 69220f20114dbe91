# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
File of all measurements that a robot knows, its own and those of others.

It is the sequence of the blocks as messages of the exchange, each after its size in four bytes. It
only grows; what a process that was killed did not complete is cut off when the next one begins.
"""

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from errno import ENOSPC
import os
from pathlib import Path

from fej_slam_ros.atomic_files import writing
from fej_slam_ros.core.peers.logs import Block
from fej_slam_ros.core.peers.messages import (
    BlockMessage, MAX_SIZE, MessageRejectedError, read, TITLE, write)
from fej_slam_ros.errors import UserError
from fej_slam_ros.output_lock import OutputLock
from fej_slam_ros.ros.files.live_files import LiveWriter

SIZE_BYTES = 4


class ExchangeFile:
    """
    A file that only one process writes, until it is closed.

    Parameters
    ----------
    path : of the file, which is made if it does not exist
    robot : name of the robot

    Attributes
    ----------
    path : of the file
    blocks : all blocks, of which those that were added since the last `flush` wait in memory

    """

    def __init__(self, path: Path, robot: str) -> None:
        self.path, self._robot = path, robot
        with ExitStack() as on_error:
            on_error.enter_context(OutputLock.of_file(path))
            with writing(path):
                self._file = on_error.enter_context(path.open('a+b', buffering=0))
                content = path.read_bytes()
            self.blocks, self._size = self._read(content)
            self._written = len(self.blocks)
            with writing(path):
                self._file.truncate(self._size)
            self._resources = on_error.pop_all()

    @property
    def waiting(self) -> Sequence[Block]:
        """Return the blocks that are not on the disk yet."""
        return self.blocks[self._written:]

    def append(self, blocks: Iterable[Block]) -> None:
        """Add blocks, which are on the disk when this returns, or raise a UserError: they wait."""
        self.blocks.extend(blocks)
        self.flush()

    def flush(self) -> None:
        """Write the blocks that wait, which are then on the disk, or raise a UserError."""
        waiting = self.waiting
        data = b''.join(
            len(message).to_bytes(SIZE_BYTES, 'little') + message
            for message in (write(BlockMessage(self._robot, block)) for block in waiting))
        if not data:
            return
        with writing(self.path):
            # A file that was deleted or unmounted could still be written.
            self.path.stat()
            # A part of what a full disk has not taken before.
            self._file.truncate(self._size)
            if self._file.write(data) != len(data):
                raise OSError(ENOSPC, os.strerror(ENOSPC))
            os.fsync(self._file.fileno())
        self._size += len(data)
        self._written += len(waiting)

    def close(self) -> None:
        """Let other processes have the file."""
        self._resources.close()

    def _read(self, content: bytes) -> tuple[list[Block], int]:
        """Return the blocks, and the size of these; an incomplete one at the end is left out."""
        blocks: list[Block] = []
        at = 0
        while at < len(content):
            begin = at + SIZE_BYTES
            end = begin + int.from_bytes(content[at:begin], 'little')
            # The file of another program may look incomplete, and must not be cut off.
            if end - begin > MAX_SIZE or not TITLE.startswith(content[begin:end][:len(TITLE)]):
                raise self._unusable('is damaged or no exchange_file')
            if end > len(content):
                break
            try:
                message = read(content[begin:end])
            except MessageRejectedError:
                raise self._unusable('is damaged or no exchange_file') from None
            if not isinstance(message, BlockMessage) or message.sender != self._robot:
                raise self._unusable(f'is not an exchange_file of {self._robot}')
            blocks.append(message.block)
            at = end
        return blocks, at

    def _unusable(self, reason: str) -> UserError:
        return UserError(
            f'{self.path} {reason}: give another path, or move the file away to begin a new run')


class LiveExchangeFile(LiveWriter):
    """
    The file in a live run, whose disk never delays it; it may go on in further runs of the node.

    Parameters
    ----------
    file : the same, written by the thread from now on

    """

    def __init__(self, file: ExchangeFile) -> None:
        self._file = file
        super().__init__(file.path)

    @property
    def blocks(self) -> Sequence[Block]:
        """Return all blocks, on the disk or not."""
        return self._file.blocks

    @property
    def waiting(self) -> Sequence[Block]:
        """Return the blocks that are not on the disk yet."""
        return self._file.waiting

    @property
    def error(self) -> str:
        """Return why blocks are not on the disk, '' if they are or soon will be."""
        error, count = super().error, len(self.waiting)
        state = f'are missing in {self._path}' if self._is_done.is_set() else 'wait in memory'
        return f'{error}; {count} blocks {state}' if error and count else error

    def append(self, blocks: Iterable[Block]) -> None:
        """Add blocks, which the thread writes soon."""
        self._file.blocks.extend(blocks)

    def finish(self) -> None:
        """Let the thread write what waits, and then let other processes have the file."""
        self._is_over.set()

    def _flush(self) -> None:
        self._file.flush()

    def _finish(self) -> None:
        self._file.close()
