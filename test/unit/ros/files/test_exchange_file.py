# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The file of the exchange on a disk with faults: one sentence, and nothing is damaged."""

from contextlib import suppress
import errno
import os

import pytest

from fej_slam_ros.core.peers.logs import Block, LogName, NO_DIGEST
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files.exchange_file import ExchangeFile
from helpers.disks import Disk, why_none

BLOCKS = [Block(LogName('p'), 1, number, NO_DIGEST, bytes(500)) for number in range(8)]


@pytest.mark.skipif(why_none() is not None, reason=str(why_none()))
@pytest.mark.parametrize(('fault', 'reason'), [
    ('make_read_only', 'Read-only file system'), ('unmount', 'No such file or directory'),
    ('fill', 'No space left on device')])
def test_a_fault_of_the_disk_is_named_each_time(tmp_path, fault, reason):
    with Disk(tmp_path) as disk:
        file = ExchangeFile(disk.path / 'p.exchange', 'p')
        file.append(BLOCKS[:1])
        getattr(disk, fault)()

        for _ in range(2):
            with pytest.raises(UserError, match=reason):
                file.append(BLOCKS[1:])
        file.close()


def test_a_file_that_was_deleted_is_named(tmp_path):
    path = tmp_path / 'p.exchange'
    file = ExchangeFile(path, 'p')
    path.unlink()

    with pytest.raises(UserError, match='No such file or directory'):
        file.append(BLOCKS)
    file.close()


def test_what_was_written_in_part_is_not_followed_by_other_blocks(tmp_path, monkeypatch):
    path = tmp_path / 'p.exchange'
    file = ExchangeFile(path, 'p')
    file.append(BLOCKS[:2])

    def failing(_):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as broken:
        broken.setattr(os, 'fsync', failing)
        with suppress(UserError):
            file.append(BLOCKS[2:4])
    file.append(BLOCKS[2:])
    file.close()

    again = ExchangeFile(path, 'p')
    assert again.blocks == BLOCKS
    again.close()
