# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
File of all measurements that a robot knows, its own and those of others.

It is the sequence of the blocks as messages of the exchange, each after its size in four bytes. It
only grows; what a process that was killed did not complete is cut off when the next one begins.
"""

from collections.abc import Iterable
from contextlib import ExitStack
import os
from pathlib import Path

from fej_slam_ros.atomic_files import writing
from fej_slam_ros.core.peers.logs import Block
from fej_slam_ros.core.peers.messages import (
    BlockMessage, MAX_SIZE, read, RefusedError, write)
from fej_slam_ros.errors import UserError
from fej_slam_ros.output_lock import OutputLock

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
    blocks : the blocks that it had

    """

    def __init__(self, path: Path, robot: str) -> None:
        self._robot = robot
        with ExitStack() as on_error:
            self._lock = on_error.enter_context(OutputLock.of_file(path))
            with writing(path):
                self._file = on_error.enter_context(path.open('a+b'))
                self.blocks = self._read(path)
            on_error.pop_all()

    def append(self, blocks: Iterable[Block]) -> None:
        """Add blocks, which are on the disk when this returns."""
        data = b''.join(
            len(message).to_bytes(SIZE_BYTES, 'little') + message
            for message in (write(BlockMessage(self._robot, block)) for block in blocks))
        if data:
            self._file.write(data)
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Let other processes have the file."""
        self._file.close()
        self._lock.release()

    def _read(self, path: Path) -> list[Block]:
        content, at = path.read_bytes(), 0
        blocks: list[Block] = []
        while at + SIZE_BYTES <= len(content):
            begin = at + SIZE_BYTES
            size = int.from_bytes(content[at:begin], 'little')
            if size > MAX_SIZE or begin + size > len(content):
                break
            try:
                message = read(content[begin:begin + size])
            except RefusedError:
                break
            if not isinstance(message, BlockMessage) or message.sender != self._robot:
                raise UserError(
                    f'{path} is not an exchange_file of {self._robot}: give each robot its own')
            blocks.append(message.block)
            at = begin + size
        if content and not blocks:
            raise UserError(f'{path} is not an exchange_file: give another path')
        self._file.truncate(at)
        return blocks
