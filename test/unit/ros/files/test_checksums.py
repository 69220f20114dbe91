# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A flipped bit of a bag is an error or has no effect; bags without checksums are named."""

import struct
import zlib

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags, checksums
from fej_slam_ros.ros.files.topic_names import RECORDED_NAMES
from helpers.paths import BAGS
from helpers.ros import meeting, ODOMETRY, odometry_message, raw, TYPES

FOOTER_SIZE = 37


@pytest.fixture
def bag(tmp_path):
    """Return a bag with checksums."""
    bags.write(tmp_path / 'bag', meeting(3))
    return tmp_path / 'bag'


def flipped(content, bit):
    damaged = bytearray(content)
    damaged[bit // 8] ^= 1 << bit % 8
    return bytes(damaged)


def refused_or_same(bag, file, number, seed):
    """Flip bits of a file one at a time; return how many of the damaged bags are refused."""
    whole, messages, errors = file.read_bytes(), list(bags.read(bag)), []
    for bit in np.random.default_rng(seed).integers(8 * len(whole), size=number):
        file.write_bytes(flipped(whole, int(bit)))
        try:
            assert list(bags.read(bag)) == messages
        except UserError as error:
            errors.append(str(error))
    file.write_bytes(whole)
    assert '\n' not in ''.join(errors)
    return len(errors)


def mcap_without(folder, is_compressed=False):
    """Write a bag as rosbags does, without checksums."""
    writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    if is_compressed:
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection('/r1/odom', ODOMETRY, typestore=TYPES)
        for stamp in (10, 20):
            writer.write(connection, stamp, raw('', odometry_message(stamp)).raw)
    return folder


def test_a_flipped_bit_is_refused_or_has_no_effect(bag):
    assert refused_or_same(bag, bag / 'bag.mcap', 25, seed=1) > 15


def test_a_flipped_bit_in_the_metadata_is_refused_or_has_no_effect(bag):
    assert refused_or_same(bag, bag / 'metadata.yaml', 15, seed=2) > 5


@pytest.mark.slow
@pytest.mark.parametrize('name', ['two_circles', 'rendezvous'])
def test_a_flipped_bit_of_a_shipped_bag_is_refused_or_has_no_effect(name, tmp_path):
    for file in (BAGS / name).iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())

    for file in tmp_path.iterdir():
        assert refused_or_same(tmp_path, file, 150, seed=3) > 50


@pytest.mark.parametrize('name', ['two_circles', 'rendezvous'])
def test_shipped_bags_have_checksums(name):
    assert bags.without_checksum(BAGS / name) == {}


def test_checksums_are_those_of_the_format(bag):
    content = (bag / 'bag.mcap').read_bytes()

    # https://mcap.dev/spec: the footer ends with the begin of the summary, of its offsets, and
    # the CRC-32 of all from the former to here; the chunk is the record after the header.
    summary, _, checksum = struct.unpack('<QQI', content[-FOOTER_SIZE + 9:-8])
    assert checksum == zlib.crc32(content[summary:-12])
    header_length, = struct.unpack('<Q', content[9:17])
    chunk = content[17 + header_length:]
    assert chunk[0] == 6
    size, checksum = struct.unpack('<QI', chunk[25:37])
    assert checksum == zlib.crc32(chunk[49:49 + size])


def test_the_damage_and_its_place_are_named(bag):
    file = bag / 'bag.mcap'
    whole = file.read_bytes()
    file.write_bytes(flipped(whole, 8 * (whole.index(b'base_link') + 1)))

    with pytest.raises(UserError) as error:
        list(bags.read(bag))

    assert str(error.value).startswith(
        f'{file} is damaged, 1 of 1 chunks of messages are damaged, the first has those logged'
        ' from 0.000 s to 0.200 s: copy it again, or ')


def test_a_topic_that_the_metadata_lack_is_not_dropped_silently(bag):
    metadata = bag / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('/r1/landmarks', '/r1/landmarkz'))

    with pytest.raises(UserError, match=r'does not list /r1/landmarks of bag\.mcap .* reindex'):
        bags.topics(bag)


@pytest.mark.parametrize('is_compressed', [False, True])
def test_an_mcap_file_without_checksums_is_named(tmp_path, is_compressed):
    bag = mcap_without(tmp_path / 'bag', is_compressed)

    assert bags.without_checksum(bag) == {'bag.mcap': '1 of 1 chunks of messages and the index'}


def test_a_damaged_compressed_chunk_is_named(tmp_path):
    bag = mcap_without(tmp_path / 'bag', is_compressed=True)
    file = bag / 'bag.mcap'
    whole = file.read_bytes()
    # The first bytes of zstandard data are 28 B5 2F FD.
    file.write_bytes(flipped(whole, 8 * whole.index(b'\x28\xb5\x2f\xfd')))

    with pytest.raises(UserError, match='1 of 1 chunks of messages are damaged'):
        list(bags.read(bag))


def test_an_sqlite3_file_has_no_checksums(tmp_path):
    bags.write(tmp_path / 'bag', meeting(3), 'sqlite3')

    assert bags.without_checksum(tmp_path / 'bag') == {'bag.db3': 'all messages'}


def test_a_checksum_of_all_data_is_verified(tmp_path):
    file = mcap_without(tmp_path / 'bag') / 'bag.mcap'
    content = file.read_bytes()
    summary, = struct.unpack('<Q', content[-FOOTER_SIZE + 9:-FOOTER_SIZE + 17])
    data = content[:summary - 13]
    sealed = data + content[summary - 13:summary - 4] + struct.pack('<I', zlib.crc32(data))
    file.write_bytes(sealed + content[summary:])
    assert checksums.mismatch(file) == ''
    assert checksums.unprotected(file) == 'the index'

    file.write_bytes(flipped(sealed, 8 * 100) + content[summary:])

    with pytest.raises(UserError, match='its data do not match their checksum'):
        bags.topics(tmp_path / 'bag')


def test_topics_with_lost_messages_are_named(bag):
    assert bags.miscounted(bag, RECORDED_NAMES) == {}
    metadata = bag / 'metadata.yaml'

    metadata.write_text(metadata.read_text().replace('message_count: 3', 'message_count: 7'))

    assert bags.miscounted(bag, RECORDED_NAMES) == {'r1/odom': (7, 3), 'r2/odom': (7, 3)}
