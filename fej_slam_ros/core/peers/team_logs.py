# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""All logs that a robot knows: its own ones, which it writes, and those it was given."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
import struct
from typing import Any, NamedTuple

from fej_slam_ros.core.peers.blocks import (
    BadBlockError, decoded, encoded, Measurement, RestOfRobotScan, RestOfScan)
from fej_slam_ros.core.peers.logs import Block, Knowledge, Log, LogName, MAX_AHEAD, NO_DIGEST
from fej_slam_ros.core.peers.messages import MAX_BLOCK_SIZE, MessageRejectedError, MessageRejection
from fej_slam_ros.core.records import Odometry, RobotScan, Scan
from fej_slam_ros.core.settings import NoiseSettings

#: Maximum number of records of a block, so that its content stays below the size that is read, and
#: of observations of a record in it: a larger scan is divided, and becomes one again where it is
#: used.
MAX_BLOCK_RECORDS, MAX_RECORD_OBSERVATIONS = 64, 8
#: Maximum number of blocks of rendezvous information.
MAX_INFORMATION = 16
#: Standard deviations of odometry and of landmarks, the three scales of noise, and the systematic
#: errors of `NoiseSettings`; then `TeamParameters`.
_FIRST_BLOCK = struct.Struct('<14d?d')
MAX_NOISE, MAX_KEYFRAME_DISTANCE = 1e6, 1e9
#: Number of records after which the size of the block is computed.
CHECK_EVERY = 8


class TeamParameters(NamedTuple):
    """Parameters that must be equal for all robots, or the same logs would give different maps."""

    shared_landmark_ids: bool = True
    keyframe_distance: float = 0.0  #: [m]


DEFAULT_PARAMETERS = TeamParameters()


@dataclass(frozen=True, slots=True, eq=False)
class LogContents:
    """Measurements of a robot as they are kept, which another process can be given quickly."""

    author: str  #: name of the robot
    blocks: Sequence[bytes]  #: the blocks of its log but for the first
    pending: Sequence[Measurement]  #: further measurements that are not in a block yet

    def measurements(self) -> list[Measurement]:
        """Return the measurements in their order, divided scans as one."""
        records: list[Measurement] = []
        for block in self.blocks:
            _appended(records, decoded(block, self.author))
        _appended(records, self.pending)
        return records


class TeamLogs:
    """
    The logs of a team as one robot knows them.

    The first block of a log of measurements has the noise of its author, so that each robot with
    the log can process it as its author does, and the team parameters. The log of a robot with
    other ones is rejected. Each run of a robot has a larger number than the ones before.

    """

    def __init__(
        self, robot: str, run: int, noise: NoiseSettings,
        parameters: TeamParameters = DEFAULT_PARAMETERS,
    ) -> None:
        self.robot, self.run = robot, run
        self.logs: dict[LogName, Log] = {}  #: all logs
        self.noise: dict[str, NoiseSettings] = {}  #: of each robot with measurements
        #: name of the parameter that differs from that of this robot, by rejected robot
        self.differing: dict[str, str] = {}
        self._parameters = parameters
        # The latest run of rendezvous information of which the first block has not arrived.
        self._next_information: dict[LogName, Log] = {}
        # The last measurement of each log, which the next block may continue.
        self._last: dict[str, list[Measurement]] = {}
        self._pending: list[Measurement] = []
        self._unchecked = 0
        self._new_blocks: list[Block] = []
        self._write(LogName(robot), [_first_block(noise, parameters)])
        self.noise[robot] = noise_of(noise)

    def record(self, measurement: Measurement) -> None:
        """Add an own measurement to the log."""
        for part in _divided(measurement):
            self._pending.append(part)
            self._unchecked += 1
            if self._unchecked >= CHECK_EVERY or len(self._pending) >= MAX_BLOCK_RECORDS:
                self._close_full_blocks()

    def flush(self) -> None:
        """Close the block of the newest own measurements, so that others can be given them."""
        self._close_full_blocks()
        if self._pending:
            self._close(len(self._pending))

    def publish(self, name: LogName, contents: list[bytes]) -> None:
        """Replace an own log by a new run of it, unless it has these contents."""
        old = self.logs.get(name)
        if old is not None and old.blocks == contents:
            return
        self.logs[name] = Log(name, self.run if old is None else old.run + 1)
        self._write(name, contents)

    def add(self, block: Block) -> bool:
        """
        Add a block; return whether it is new. A MessageRejectedError says that it cannot be used.

        Blocks may arrive in any order and any number of times.

        """
        log = self._log_for(block)
        if log.contains(block.number):
            known = log.block(block.number)
            if (known.digest, known.content) != (block.digest, block.content):
                raise MessageRejectedError(MessageRejection.CONTRADICTION)
            return False
        if block.number >= (MAX_INFORMATION if block.log.about else len(log.blocks) + MAX_AHEAD):
            raise MessageRejectedError(MessageRejection.TOO_FAR_AHEAD)
        if log is not self.logs.get(block.log):
            if block.number > 0:
                log.ahead[block.number] = block
                return True
            if block.digest != NO_DIGEST:
                raise MessageRejectedError(MessageRejection.CONTRADICTION)
            if not block.log.about:
                self._checked_content(block)
            self._replace(log)
        log.ahead[block.number] = block
        self._append_ahead(log)
        return True

    def has_written(self, knowledge: Knowledge) -> bool:
        """Return whether this robot has written the blocks that another one has of its log."""
        log = self.logs[LogName(self.robot)]
        if knowledge.run != log.run:
            return knowledge.run < log.run
        return knowledge.count <= len(log.blocks) and log.is_prefix(knowledge)

    def take_new_blocks(self) -> list[Block]:
        """Return the blocks that have become part of a log since the last call, in order."""
        new, self._new_blocks = self._new_blocks, []
        return new

    def restore(self, block: Block) -> None:
        """Add a block of an earlier process of this robot, in the order of `take_new_blocks`."""
        log = self.logs.get(block.log)
        if log is None or block.run != log.run or block.number == 0:
            log = Log(block.log, block.run)
            self._replace(log)
        log.ahead[block.number] = block
        self._append_ahead(log)
        self._new_blocks.clear()
        if block.log == LogName(self.robot):
            self.run = block.run

    @property
    def robots(self) -> list[str]:
        """Return the names of the robots with measurements: this one, and others by name."""
        return [self.robot, *sorted(self.noise.keys() - {self.robot})]

    def contents(self, robot: str) -> LogContents:
        """Return the measurements of a robot, without those that wait for a missing block."""
        log = self.logs.get(LogName(robot))
        return LogContents(
            robot, () if log is None else log.blocks[1:],
            [*self._pending] if robot == self.robot else ())

    def size(self) -> int:
        """Return the size of all logs [bytes]."""
        return sum(len(content) for log in self.logs.values() for content in log.blocks)

    def _log_for(self, block: Block) -> Log:
        """Return the log that a block belongs to, a new one for a new run of its author."""
        log = self.logs.get(block.log)
        if log is not None and block.run < log.run:
            raise MessageRejectedError(MessageRejection.OLD_RUN)
        present = log if log is not None and block.run == log.run else None
        if block.log.author == self.robot and not (
                present is not None and present.contains(block.number)):
            if block.run < self.run:
                # Others still have the information of an earlier run.
                raise MessageRejectedError(MessageRejection.OLD_RUN)
            raise MessageRejectedError(MessageRejection.SAME_NAME)
        if present is not None:
            return present
        if log is None:
            self._replace(Log(block.log, block.run))
            return self.logs[block.log]
        # A known log is replaced only by a run whose first block is valid.
        if not block.log.about:
            if block.number > 0:
                raise MessageRejectedError(MessageRejection.TOO_FAR_AHEAD)
            return Log(block.log, block.run)
        coming = self._next_information.get(block.log)
        if coming is not None and block.run < coming.run:
            raise MessageRejectedError(MessageRejection.OLD_RUN)
        if coming is None or coming.run < block.run:
            coming = self._next_information[block.log] = Log(block.log, block.run)
        return coming

    def _replace(self, log: Log) -> None:
        self.logs[log.name] = log
        self._next_information.pop(log.name, None)
        if not log.name.about:
            self._last.pop(log.name.author, None)
            self.noise.pop(log.name.author, None)
            self.differing.pop(log.name.author, None)

    def _append_ahead(self, log: Log) -> None:
        """Append the blocks that wait for no other one."""
        while (block := log.ahead.get(len(log.blocks))) is not None:
            try:
                if block.digest != log.digests[-1]:
                    raise MessageRejectedError(MessageRejection.CONTRADICTION)
                if not log.name.about:
                    self._use(log.name.author, block)
            except MessageRejectedError as rejected:
                # Further blocks may not be from the author either.
                log.ahead.clear()
                log.is_ended = rejected.reason is not MessageRejection.CONTRADICTION
                raise
            del log.ahead[block.number]
            self._new_blocks.append(log.append(block.content))

    def _use(self, author: str, block: Block) -> None:
        content = self._checked_content(block)
        if isinstance(content, NoiseSettings):
            self.noise[author] = content
        else:
            known = [*self._last.get(author, ())]
            if not _appended(known, content):
                raise MessageRejectedError(MessageRejection.BAD_CONTENT)
            self._last[author] = known[-1:]

    def _checked_content(self, block: Block) -> NoiseSettings | list[Measurement]:
        """Return the content of a block of measurements, or raise a MessageRejectedError."""
        try:
            if block.number > 0:
                return decoded(block.content, block.log.author)
            noise, parameters = _read_first_block(block.content)
        except BadBlockError:
            raise MessageRejectedError(MessageRejection.BAD_CONTENT) from None
        for name, own, other in zip(TeamParameters._fields, self._parameters, parameters):
            if other != own:
                self.differing[block.log.author] = name
                raise MessageRejectedError(MessageRejection(f'other_{name}'))
        return noise

    def _close_full_blocks(self) -> None:
        """Close blocks while the pending measurements do not fit into one."""
        self._unchecked = 0
        while len(self._pending) > 1 and (
                len(self._pending) >= MAX_BLOCK_RECORDS
                or len(encoded(self._pending)) > MAX_BLOCK_SIZE):
            count = min(len(self._pending), MAX_BLOCK_RECORDS)
            while count > 1 and len(encoded(self._pending[:count])) > MAX_BLOCK_SIZE:
                count -= max(count // CHECK_EVERY, 1)
            self._close(count)

    def _close(self, count: int) -> None:
        records = self._pending[:count]
        del self._pending[:count]
        self._write(LogName(self.robot), [encoded(records)])

    def _write(self, name: LogName, contents: list[bytes]) -> None:
        log = self.logs.setdefault(name, Log(name, self.run))
        self._new_blocks += [log.append(content) for content in contents]


def _divided(measurement: Measurement) -> Iterator[Measurement]:
    """Yield a measurement, or a large scan in parts that fit into blocks."""
    if isinstance(measurement, Odometry) or (
            len(measurement.observations) <= MAX_RECORD_OBSERVATIONS):
        yield measurement
        return
    robot, stamp = measurement.robot, measurement.stamp
    for k in range(0, len(measurement.observations), MAX_RECORD_OBSERVATIONS):
        part = slice(k, k + MAX_RECORD_OBSERVATIONS)
        if isinstance(measurement, RobotScan):
            of_robots = RestOfRobotScan if k else RobotScan
            yield of_robots(robot, stamp, measurement.observations[part])
        else:
            of_landmarks = RestOfScan if k else Scan
            yield of_landmarks(robot, stamp, measurement.observations[part])


def _appended(records: list[Measurement], parts: Iterable[Measurement]) -> bool:
    """Append measurements, with divided scans as one; return whether there is one to each rest."""
    for part in parts:
        if not isinstance(part, (RestOfScan, RestOfRobotScan)):
            records.append(part)
            continue
        kind = RobotScan if isinstance(part, RestOfRobotScan) else Scan
        if not records or not isinstance(begun := records[-1], kind):
            return False
        whole: Any = (*begun.observations, *part.observations)
        records[-1] = replace(begun, observations=whole)
    return True


def noise_of(robot: NoiseSettings) -> NoiseSettings:
    """Return the noise of a robot without its other settings."""
    return NoiseSettings(**{
        field.name: getattr(robot, field.name) for field in fields(NoiseSettings)})


def _first_block(noise: NoiseSettings, parameters: TeamParameters) -> bytes:
    return _FIRST_BLOCK.pack(
        *noise.odometry_sigma, *noise.landmark_sigma, noise.odometry_noise_scale,
        noise.landmark_noise_scale, noise.robot_noise_scale, *noise.odometry_scale,
        noise.observation_range_scale, noise.observation_noise_growth, noise.odometry_turn_bias,
        noise.observation_bearing_bias,
        *parameters)


def _read_first_block(content: bytes) -> tuple[NoiseSettings, TeamParameters]:
    """Return the noise and the parameters in the first block, or raise a BadBlockError."""
    if len(content) != _FIRST_BLOCK.size:
        raise BadBlockError('its size is not that of a first block')
    *positive, growth, turn_bias, bearing_bias, shared_landmark_ids, keyframe_distance = (
        _FIRST_BLOCK.unpack(content))
    if not (all(0.0 < value < MAX_NOISE for value in positive)
            and max(abs(turn_bias), abs(bearing_bias)) < MAX_NOISE
            and 0.0 <= growth < MAX_NOISE):
        raise BadBlockError('noise is positive and finite')
    if not 0.0 <= keyframe_distance <= MAX_KEYFRAME_DISTANCE:
        raise BadBlockError('the distance of keyframes is not negative, and finite')
    x, y, phi, z_x, z_y, *scales, distance, turn, range_scale = positive
    noise = NoiseSettings(
        odometry_sigma=(x, y, phi), landmark_sigma=(z_x, z_y), odometry_noise_scale=scales[0],
        landmark_noise_scale=scales[1], robot_noise_scale=scales[2],
        odometry_scale=(distance, turn), odometry_turn_bias=turn_bias,
        observation_range_scale=range_scale, observation_bearing_bias=bearing_bias,
        observation_noise_growth=growth)
    return noise, TeamParameters(shared_landmark_ids, keyframe_distance)
