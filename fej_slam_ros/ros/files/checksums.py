# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Checksums (CRC-32) of mcap files: of each chunk of messages, of the index and of all data.

A checksum of 0 means that there is none. rosbag2 writes those of chunks and index; rosbags writes
none, and verifies those of chunks when it reads them. The format is that of
https://mcap.dev/spec.
"""

from collections.abc import Iterator
from pathlib import Path
from struct import Struct
from typing import BinaryIO, NamedTuple
import zlib

from rosbags.rosbag2.storage_mcap import decompress

from fej_slam_ros.core.records import NS

MAGIC = b'\x89MCAP0\r\n'
MESSAGE, CHUNK, DATA_END = 0x05, 0x06, 0x0F
#: Begin of a record: opcode, and length of the content [bytes].
RECORD_HEAD = Struct('<BQ')
#: Begin of a chunk: first and last log time [ns], uncompressed size [bytes], checksum, and length
#: of the name of the compression. The name, the compressed size and the data follow.
CHUNK_HEAD = Struct('<QQQII')
CHUNK_CHECKSUM_OFFSET = 24
#: Last record of the data: opcode, length, checksum of all data.
DATA_END_RECORD = Struct('<BQI')
#: Last record of a file: opcode, length, begin of the index (0: none) and of a part of it,
#: checksum of the index up to here.
FOOTER = Struct('<BQQQI')
CHECKSUM = Struct('<I')
SIZE = Struct('<Q')
#: Bytes read at a time for the checksum of all data.
BLOCK_SIZE = 1 << 20


class McapRecord(NamedTuple):
    """Place of a record in a file."""

    opcode: int  #: its kind
    content: int  #: begin of its content [bytes]
    length: int  #: of its content [bytes]


def add(path: Path) -> None:
    """Fill in the checksums of uncompressed chunks and of the index of a complete file."""
    with path.open('r+b') as file:
        for record in _records(file):
            if record.opcode == CHUNK:
                *_, data = _chunk(file, record)
                checksum = zlib.crc32(data)
                file.seek(record.content + CHUNK_CHECKSUM_OFFSET)
                file.write(CHECKSUM.pack(checksum))
        _, index = _index(file)
        file.seek(-len(MAGIC) - CHECKSUM.size, 2)
        file.write(CHECKSUM.pack(zlib.crc32(index)))


def unprotected(path: Path) -> str:
    """Return which parts of a file have no checksum, '' if none."""
    with path.open('rb') as file:
        of_index, _ = _index(file)
        of_data, _ = _data_end(file)
        records = [*_records(file)]
        chunks = [_chunk_head(file, record)[3] for record in records if record.opcode == CHUNK]
    parts = [] if of_index else ['the index']
    if not of_data and 0 in chunks:
        parts.insert(0, f'{chunks.count(0)} of {len(chunks)} chunks of messages')
    if not of_data and any(record.opcode == MESSAGE for record in records):
        parts.insert(0, 'the messages')
    return ' and '.join(parts)


def mismatch(path: Path) -> str:
    """Return what does not match a checksum of the index or of all data, '' if nothing."""
    with path.open('rb') as file:
        of_index, index = _index(file)
        if of_index not in {0, zlib.crc32(index)}:
            return 'its index does not match its checksum'
        of_data, end = _data_end(file)
        if of_data and of_data != _checksum_of_data(file, end):
            return 'its data do not match their checksum'
    return ''


def damaged_chunks(path: Path) -> str:
    """Return the number of damaged chunks and the log times of the first, '' if none."""
    with path.open('rb') as file:
        records = [record for record in _records(file) if record.opcode == CHUNK]
        damaged = [record for record in records if _is_damaged(file, record)]
        if not damaged:
            return ''
        first, last, *_ = _chunk_head(file, damaged[0])
    return (
        f'{len(damaged)} of {len(records)} chunks of messages are damaged, the first has those'
        f' logged from {first / NS:.3f} s to {last / NS:.3f} s')


def _records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of the data, as far as they are complete."""
    begin, size = len(MAGIC), file.seek(0, 2)
    while begin + RECORD_HEAD.size <= size:
        opcode, length = _unpack(file, RECORD_HEAD, begin)
        record = McapRecord(opcode, begin + RECORD_HEAD.size, length)
        begin = record.content + length
        if begin > size or opcode == DATA_END:
            return
        yield record


def _chunk_head(file: BinaryIO, record: McapRecord) -> tuple[int, ...]:
    return _unpack(file, CHUNK_HEAD, record.content)


def _chunk(file: BinaryIO, record: McapRecord) -> tuple[str, bytes]:
    """Return the name of the compression of a chunk, '' for none, and its data as stored."""
    *_, length = _chunk_head(file, record)
    compression = file.read(length).decode(errors='replace')
    size, = SIZE.unpack(file.read(SIZE.size))
    return compression, file.read(min(size, record.length))


def _is_damaged(file: BinaryIO, record: McapRecord) -> bool:
    """Return whether a chunk cannot be decompressed, or does not match its checksum."""
    _, _, size, checksum, _ = _chunk_head(file, record)
    compression, data = _chunk(file, record)
    try:
        decompress(data, compression, size, checksum)
    # Each decompressor raises errors of its own.
    except Exception:  # noqa: BLE001
        return True
    return False


def _index(file: BinaryIO) -> tuple[int, bytes]:
    """Return the checksum of the index, and the bytes that it covers."""
    footer = file.seek(-len(MAGIC) - FOOTER.size, 2)
    _, _, begin, _, checksum = _unpack(file, FOOTER, footer)
    covered_end = footer + FOOTER.size - CHECKSUM.size
    file.seek(begin or footer)
    return checksum, file.read(covered_end - file.tell())


def _data_end(file: BinaryIO) -> tuple[int, int]:
    """Return the checksum of all data, and how many bytes it covers."""
    _, index = _index(file)
    end = file.tell() - len(index) - DATA_END_RECORD.size
    opcode, _, checksum = _unpack(file, DATA_END_RECORD, end)
    return checksum if opcode == DATA_END else 0, end


def _checksum_of_data(file: BinaryIO, end: int) -> int:
    file.seek(0)
    checksum = 0
    while file.tell() < end:
        checksum = zlib.crc32(file.read(min(BLOCK_SIZE, end - file.tell())), checksum)
    return checksum


def _unpack(file: BinaryIO, layout: Struct, begin: int) -> tuple[int, ...]:
    file.seek(begin)
    return layout.unpack(file.read(layout.size))
