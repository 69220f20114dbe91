# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages between robots as bytes: *hello* (the blocks of the sender) and *block* (a part of a log).

All are small enough for one packet of a network, as a lost packet loses the whole message. Each
has a checksum, and a digest of the format by which messages of another version are rejected even
if its number is the same::

    3 bytes   'FEJ'
    4         digest of the version and of the fields of measurements
    1         kind: 1 hello, 2 block
    1 + n     name of the sender, UTF-8, after its length
    ...       content, see `_hello` and `_block`
    4         CRC-32 of all before
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from enum import Enum
import struct
import zlib

from fej_slam_ros.core.peers.logs import Block, DIGEST_SIZE, Knowledge, LogName, MAX_AHEAD
from fej_slam_ros.core.records import Observation, Odometry, RobotObservation, RobotScan, Scan

#: Number of the format, and the records that blocks contain.
VERSION, RECORDS = 5, (Odometry, Scan, Observation, RobotScan, RobotObservation)
_SCHEMA = zlib.crc32(
    repr([VERSION, *([field.name for field in fields(r)] for r in RECORDS)]).encode())
#: The first bytes of every message.
TITLE = b'FEJ' + _SCHEMA.to_bytes(4, 'little')
#: Largest size of a message [bytes]: with the headers of DDS and UDP it fits into 1,500 bytes.
MAX_SIZE = 1_300
#: Largest size of the content of a block [bytes], beside three names of 64 bytes and 32 others.
MAX_BLOCK_SIZE = 1_047

_HELLO, _BLOCK = 1, 2
_STAMP, _COUNT, _RUN = struct.Struct('<q'), struct.Struct('<I'), struct.Struct('<q')
_ECHO, _CRC = struct.Struct('<II'), struct.Struct('<I')
#: Modulus of times in echoes [ms], of 49 days.
ECHO_MODULUS = 2**32


class MessageRejection(str, Enum):
    """Reason why a message of another robot is not used; the value is its reported name."""

    TRUNCATED = 'truncated'
    OTHER_VERSION = 'other_version'
    CORRUPT = 'corrupt'
    UNKNOWN_ROBOT = 'unknown_robot'
    SAME_NAME = 'same_name'
    OLD_RUN = 'old_run'
    TOO_FAR_AHEAD = 'too_far_ahead'
    CONTRADICTION = 'contradiction'
    BAD_CONTENT = 'bad_content'
    OTHER_SHARED_LANDMARK_IDS = 'other_shared_landmark_ids'
    OTHER_KEYFRAME_DISTANCE = 'other_keyframe_distance'


class MessageRejectedError(Exception):
    """A message is not used."""

    def __init__(self, reason: MessageRejection) -> None:
        super().__init__(reason.value)
        self.reason = reason


@dataclass(frozen=True, slots=True)
class Hello:
    """List of the logs that a robot has, sent in each period."""

    sender: str
    run: int  #: its present run
    stamp: int  #: time at which it was sent [ns]
    logs: int  #: number of logs of which it has blocks
    known: tuple[Knowledge, ...]  #: its blocks of all or some of these
    #: for each robot in reach by its key: the stamp of its newest hello and the time since
    #: this was received [ms], modulo ECHO_MODULUS; only in the first of several hellos
    echoes: Mapping[int, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BlockMessage:
    """A block that a robot passes on."""

    sender: str
    block: Block


Message = Hello | BlockMessage


def write(message: Message) -> bytes:
    """Return a message as bytes."""
    kind, content = (
        (_HELLO, _hello(message)) if isinstance(message, Hello) else (_BLOCK, _block(message)))
    frame = TITLE + bytes([kind]) + _text(message.sender) + content
    return frame + _CRC.pack(zlib.crc32(frame))


def read(data: bytes) -> Message:
    """Return the message in some bytes, or raise a MessageRejectedError."""
    if len(data) < len(TITLE) + 1 + _CRC.size:
        raise MessageRejectedError(MessageRejection.TRUNCATED)
    if len(data) > MAX_SIZE:
        raise MessageRejectedError(MessageRejection.CORRUPT)
    if not data.startswith(TITLE):
        raise MessageRejectedError(MessageRejection.OTHER_VERSION)
    frame, crc = data[:-_CRC.size], data[-_CRC.size:]
    if _CRC.unpack(crc) != (zlib.crc32(frame),):
        raise MessageRejectedError(MessageRejection.CORRUPT)
    kind, reader = data[len(TITLE)], _MessageReader(frame, len(TITLE) + 1)
    sender = reader.text()
    if kind == _HELLO:
        return _read_hello(reader, sender)
    if kind == _BLOCK:
        return _read_block(reader, sender)
    raise MessageRejectedError(MessageRejection.CORRUPT)


def echo_key(robot: str) -> int:
    """Return the key of a robot in echoes: the CRC-32 of its name, as names may be long."""
    return zlib.crc32(robot.encode())


def hellos(
    sender: str, run: int, stamp: int, known: Sequence[Knowledge], echoes: Mapping[int, int]
) -> Iterator[bytes]:
    """Yield the hellos with all that a robot has: one or, for many logs, several."""
    space = MAX_SIZE - len(write(Hello(sender, run, stamp, 0, ())))
    parts: list[list[Knowledge]] = [[]]
    free = space - len(echoes) * _ECHO.size
    for knowledge in known:
        size = len(_knowledge(knowledge))
        if size > free:
            parts.append([])
            free = space
        parts[-1].append(knowledge)
        free -= size
    for k, part in enumerate(parts):
        yield write(Hello(sender, run, stamp, len(known), tuple(part), {} if k else echoes))


def _hello(hello: Hello) -> bytes:
    return b''.join([
        _RUN.pack(hello.run), _STAMP.pack(hello.stamp), _COUNT.pack(hello.logs),
        _COUNT.pack(len(hello.known)), *map(_knowledge, hello.known),
        *(_ECHO.pack(key, time) for key, time in hello.echoes.items())])


def _knowledge(known: Knowledge) -> bytes:
    """Return the name, run, count, digest, a flag for the end, and a bitmap of further blocks."""
    bits = sum(1 << number - known.count for number in known.ahead)
    bitmap = bits.to_bytes((bits.bit_length() + 7) // 8, 'little')
    return b''.join([
        _log_name(known.log), _RUN.pack(known.run), _COUNT.pack(known.count), known.digest,
        bytes([known.is_ended, len(bitmap)]), bitmap])


def _block(message: BlockMessage) -> bytes:
    block = message.block
    return b''.join([
        _log_name(block.log), _RUN.pack(block.run), _COUNT.pack(block.number), block.digest,
        block.content])


def _read_hello(reader: '_MessageReader', sender: str) -> Hello:
    run = reader.number(_RUN)
    stamp = reader.number(_STAMP)
    logs = reader.number(_COUNT)
    count = reader.number(_COUNT)
    known = tuple(_read_knowledge(reader) for _ in range(count))
    echoes = dict(_ECHO.iter_unpack(reader.rest(_ECHO.size)))
    return Hello(sender, run, stamp, logs, known, echoes)


def _read_knowledge(reader: '_MessageReader') -> Knowledge:
    log = reader.log_name()
    run = reader.number(_RUN)
    count = reader.number(_COUNT)
    digest = reader.take(DIGEST_SIZE)
    is_ended, size = reader.take(2)
    bits = int.from_bytes(reader.take(size), 'little')
    ahead = frozenset(count + k for k in range(MAX_AHEAD) if bits >> k & 1)
    return Knowledge(log, run, count, digest, ahead, is_ended > 0)


def _read_block(reader: '_MessageReader', sender: str) -> BlockMessage:
    log = reader.log_name()
    run = reader.number(_RUN)
    number = reader.number(_COUNT)
    digest = reader.take(DIGEST_SIZE)
    return BlockMessage(sender, Block(log, run, number, digest, reader.rest()))


def _log_name(name: LogName) -> bytes:
    return _text(name.author) + _text(name.about)


def _text(text: str) -> bytes:
    encoded = text.encode()
    return bytes([len(encoded)]) + encoded


class _MessageReader:
    """Reads the parts of a message one after the other."""

    def __init__(self, frame: bytes, at: int) -> None:
        self._frame, self._at = frame, at

    def take(self, size: int) -> bytes:
        begin, self._at = self._at, self._at + size
        if self._at > len(self._frame):
            raise MessageRejectedError(MessageRejection.TRUNCATED)
        return self._frame[begin:self._at]

    def number(self, form: struct.Struct) -> int:
        value: int = form.unpack(self.take(form.size))[0]
        return value

    def text(self) -> str:
        try:
            return self.take(self.take(1)[0]).decode()
        except UnicodeDecodeError as error:
            raise MessageRejectedError(MessageRejection.CORRUPT) from error

    def log_name(self) -> LogName:
        return LogName(self.text(), self.text())

    def rest(self, unit: int = 1) -> bytes:
        """Take all that remains; it is truncated unless its size is a multiple of a unit."""
        size = len(self._frame) - self._at
        return self.take(size + -size % unit)
