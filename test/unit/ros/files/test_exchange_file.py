# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The file of the exchange on a disk with faults: one sentence, and nothing is damaged."""

from contextlib import closing, suppress
import errno
import os
from threading import Event

import pytest

from fej_slam_ros.core.peers.logs import Block, LogName, NO_DIGEST
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import live_files
from fej_slam_ros.ros.files.exchange_file import ExchangeFile, LiveExchangeFile
from helpers.disks import Disk, why_none
from helpers.processes import until

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
                file.append(BLOCKS[1:3])
        assert file.waiting == [*BLOCKS[1:3], *BLOCKS[1:3]]
        file.close()


def test_a_file_that_was_deleted_is_named(tmp_path):
    path = tmp_path / 'p.exchange'
    file = ExchangeFile(path, 'p')
    path.unlink()

    with pytest.raises(UserError, match='No such file or directory'):
        file.append(BLOCKS)
    file.close()


def failing(_):
    raise OSError(errno.EIO, os.strerror(errno.EIO))


def blocks_in(path):
    """Return the blocks that the next process finds."""
    with closing(ExchangeFile(path, 'p')) as file:
        return file.blocks


def test_what_was_written_in_part_is_not_followed_by_other_blocks(tmp_path, monkeypatch):
    path = tmp_path / 'p.exchange'
    file = ExchangeFile(path, 'p')
    file.append(BLOCKS[:2])

    with monkeypatch.context() as broken:
        broken.setattr(os, 'fsync', failing)
        with suppress(UserError):
            file.append(BLOCKS[2:4])
    file.append(BLOCKS[4:])
    file.close()

    assert blocks_in(path) == BLOCKS


@pytest.mark.parametrize('size', [1, 100, 500, 536, 540])
def test_an_incomplete_block_at_the_end_is_cut_off(tmp_path, size):
    path = tmp_path / 'p.exchange'
    with closing(ExchangeFile(path, 'p')) as file:
        file.append(BLOCKS)
    whole = path.read_bytes()
    path.write_bytes(whole[:-size])

    assert blocks_in(path) == BLOCKS[:-1 if size <= len(whole) // len(BLOCKS) else -2]


@pytest.mark.parametrize(
    'content', [b'on\n', b'a text of another program\n', bytes([40, 0, 0, 0]) + b'its data'])
def test_a_file_of_another_program_stays_as_it_is(tmp_path, content):
    path = tmp_path / 'p.exchange'
    path.write_bytes(content)

    with pytest.raises(UserError, match='no exchange_file'):
        ExchangeFile(path, 'p')

    assert path.read_bytes() == content


def test_in_a_live_run_what_a_broken_disk_does_not_take_waits_and_is_reported(
    tmp_path, monkeypatch
):
    path = tmp_path / 'p.exchange'
    file = LiveExchangeFile(ExchangeFile(path, 'p'))
    with monkeypatch.context() as broken:
        broken.setattr(os, 'fsync', failing)
        file.append(BLOCKS)
        until(lambda: file.error, lambda: None)
        assert file.error == (
            f'cannot write {path}: Input/output error: choose a path that can be written;'
            ' 8 blocks wait in memory')
        assert file.waiting == BLOCKS
    until(lambda: not file.waiting, lambda: None)
    file.finish()

    assert file.wait(10.0) == ''
    assert blocks_in(path) == BLOCKS


def test_a_broken_disk_at_the_end_is_an_error_with_what_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(os, 'fsync', failing)
    file = LiveExchangeFile(ExchangeFile(tmp_path / 'p.exchange', 'p'))
    file.append(BLOCKS)
    file.finish()

    assert file.wait(10.0).endswith(f'; 8 blocks are missing in {tmp_path / "p.exchange"}')


def test_a_disk_that_takes_nothing_delays_only_the_end_of_a_live_run(tmp_path, monkeypatch):
    monkeypatch.setattr(live_files, 'SLOW_AFTER', 0.0)
    path, free, begun = tmp_path / 'p.exchange', Event(), Event()
    monkeypatch.setattr(os, 'fsync', lambda _: (begun.set(), free.wait()))
    file = LiveExchangeFile(ExchangeFile(path, 'p'))

    file.append(BLOCKS[:2])
    begun.wait()
    file.append(BLOCKS[2:])

    # What the disk has begun to take is not safe.
    assert file.waiting == BLOCKS
    assert f'{path} takes no data for' in file.error
    file.finish()
    assert file.wait(0.05) == f'{path} is not complete: it is still being written'
    free.set()
    assert file.wait(10.0) == ''
    assert blocks_in(path) == BLOCKS
