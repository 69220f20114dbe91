# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages between robots: whole, small, and rejected by name where they are damaged."""

import pytest

from fej_slam_ros.core.peers.logs import Block, Knowledge, LogName, NO_DIGEST
from fej_slam_ros.core.peers.messages import (
    BlockMessage, echo_key, Hello, hellos, MAX_BLOCK_SIZE, MAX_SIZE, MessageRejectedError,
    MessageRejection, read, write)

HELLO = Hello('p', 5, 17, 3, (
    Knowledge(LogName('p'), 5, 12, b'abcdefgh', frozenset({14, 20, 267})),
    Knowledge(LogName('q', 'p'), 3, 0, NO_DIGEST, frozenset(), True)), {echo_key('q'): 2**32 - 1})
BLOCK = BlockMessage('p', Block(LogName('q'), 5, 12, b'abcdefgh', bytes(range(256))))


@pytest.mark.parametrize('message', [HELLO, BLOCK])
def test_a_message_is_read_as_it_was_written(message):
    assert read(write(message)) == message


@pytest.mark.parametrize('message', [HELLO, BLOCK])
def test_a_message_with_a_changed_byte_or_without_its_end_is_rejected(message):
    data = write(message)
    for k in range(len(data)):
        for wrong in (data[:k], data[:k] + bytes([data[k] ^ 1]) + data[k + 1:]):
            with pytest.raises(MessageRejectedError):
                read(wrong)


def test_another_version_is_named():
    data = bytearray(write(HELLO))
    data[3] ^= 1

    with pytest.raises(MessageRejectedError) as rejected:
        read(bytes(data))
    assert rejected.value.reason is MessageRejection.OTHER_VERSION


def test_a_block_of_full_size_fits_into_one_packet():
    # Names of robots have at most 64 characters.
    block = Block(LogName('p' * 64, 'q' * 64), 2**60, 2**30, NO_DIGEST, bytes(MAX_BLOCK_SIZE))

    message = write(BlockMessage('r' * 64, block))

    assert len(message) <= MAX_SIZE
    assert read(message).block == block
    # 1,500 bytes less the headers of IP, UDP and RTPS, and the layout of the array.
    assert MAX_SIZE <= 1500 - 28 - 100


def test_a_message_that_no_robot_sends_is_rejected_by_its_size():
    block = Block(LogName('p'), 1, 1, NO_DIGEST, bytes(MAX_SIZE))

    with pytest.raises(MessageRejectedError):
        read(write(BlockMessage('p', block)))


def test_knowledge_of_many_logs_is_divided_into_several_messages():
    known = [Knowledge(LogName(f'robot_{k}'), k, 3, NO_DIGEST) for k in range(100)]

    # The largest team, all of it in reach.
    echoes = {echo_key(f'robot_{k}'): k for k in range(99)}

    messages = [*hellos('p' * 64, 1, 2, known, echoes)]

    assert max(map(len, messages)) <= MAX_SIZE
    received = [entry for data in messages for entry in read(data).known]
    assert received == known
    assert {read(data).logs for data in messages} == {100}
    assert [read(data).echoes for data in messages] == [echoes, *[{}] * (len(messages) - 1)]
