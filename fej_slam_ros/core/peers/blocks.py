# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Measurements of one robot as bytes: exact, compressed, and checked where they are read.

A block is a sequence of columns of one type each, as these compress better than records do, with
the first bytes of all numbers before their second ones.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from typing import Any
import zlib

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.definiteness import has_information
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import (
    AnyObservation, AnyScan, NS, Observation, Odometry, RobotObservation, RobotScan, Scan)

#: A measurement of a robot.
Measurement = Odometry | AnyScan
#: Largest size of a block before compression [bytes].
MAX_CONTENT = 65_536
#: Largest absolute value of a number in a block: more than that of messages, 1e12, as entries of a
#: covariance may double when it is rotated into the base frame.
MAX_VALUE = 1e13
#: Latest stamp that a message of ROS can have [ns].
MAX_STAMP = (2**31 - 1) * NS
#: Largest difference between the transposed entries of a covariance, relative to the largest one.
SYMMETRY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class RestOfScan(Scan):
    """Further observations of the scan before it, which was too large for one block."""


@dataclass(frozen=True, slots=True, eq=False)
class RestOfRobotScan(RobotScan):
    """Further observations of the robot scan before it."""


#: Kinds of measurements; odometry comes without or with a covariance.
_WITHOUT_COVARIANCE, _WITH_COVARIANCE = 0, 1
_SCANS = {2: Scan, 4: RestOfScan}
_ROBOT_SCANS = {3: RobotScan, 5: RestOfRobotScan}
_KIND_OF = {record_type: kind for kind, record_type in (_SCANS | _ROBOT_SCANS).items()}


class BadBlockError(ValueError):
    """The content of a block cannot be measurements of a robot."""


def encoded(records: Sequence[Measurement]) -> bytes:
    """Return the block of some measurements of one robot."""
    odometry = [r for r in records if isinstance(r, Odometry)]
    scans = [r for r in records if isinstance(r, Scan)]
    robot_scans = [r for r in records if isinstance(r, RobotScan)]
    all_scans: list[AnyScan] = [*scans, *robot_scans]
    of_landmarks: list[Observation] = [o for scan in scans for o in scan.observations]
    of_robots: list[RobotObservation] = [o for scan in robot_scans for o in scan.observations]
    observations: list[AnyObservation] = [*of_landmarks, *of_robots]
    names = sorted({o.observed for o in of_robots})
    covariances = [r.twist_covariance for r in odometry if r.twist_covariance is not None]
    text = '\0'.join(names).encode()
    columns = [
        np.array([len(records), len(text)], '<u4'),
        np.frombuffer(text, 'u1'),
        np.array([_kind(r) for r in records], 'u1'),
        np.diff(np.array([r.stamp for r in records], '<i8'), prepend=0),
        np.array([r.pose for r in odometry], '<f8'), np.array(covariances, '<f8'),
        np.array([len(scan.observations) for scan in all_scans], '<u4'),
        np.array([o.id for o in of_landmarks], '<i4'),
        np.array([names.index(o.observed) for o in of_robots], '<u2'),
        np.array([o.z for o in observations], '<f8'), np.array([o.R for o in observations], '<f8')]
    return zlib.compress(b''.join(_bytes_by_significance(column) for column in columns), 9)


def decoded(block: bytes, robot: str) -> list[Measurement]:
    """Return the measurements of a robot in a block, or raise a BadBlockError."""
    columns = _Columns(block)
    count, length = columns.take('<u4', 2).tolist()
    text = columns.take('u1', length).tobytes()
    kinds = columns.take('u1', count)
    stamps = np.cumsum(columns.take('<i8', count))
    _require(not count or (
        int(kinds.max()) <= max(_ROBOT_SCANS)
        and 0 <= int(stamps.min()) <= int(stamps.max()) <= MAX_STAMP))
    n = np.bincount(kinds, minlength=6).tolist()
    scans, robot_scans = (sum(n[kind] for kind in types) for types in (_SCANS, _ROBOT_SCANS))
    poses = columns.take('<f8', 3 * (n[0] + n[1])).reshape(-1, 3)
    Q = columns.take('<f8', 9 * n[_WITH_COVARIANCE]).reshape(-1, 3, 3)
    sizes = columns.take('<u4', scans + robot_scans).tolist()
    m, m_robots = sum(sizes[:scans]), sum(sizes[scans:])
    ids = columns.take('<i4', m).tolist()
    indices = columns.take('<u2', m_robots).tolist()
    z = columns.take('<f8', 2 * (m + m_robots)).reshape(-1, 2)
    R = columns.take('<f8', 4 * (m + m_robots)).reshape(-1, 2, 2)
    columns.end()
    _check(poses, Q, z, R)
    _require(min(ids, default=0) >= 0)
    names = _names(text)
    _require(max(indices, default=-1) < len(names) and robot not in names)
    observations: Iterator[Any] = chain(
        (Observation(*values) for values in zip(ids, z, R)),
        (RobotObservation(names[k], *values) for k, *values in zip(indices, z[m:], R[m:])))
    by_scan = [tuple(islice(observations, size)) for size in sizes]
    return _records(
        robot, zip(kinds.tolist(), stamps.tolist()), iter(by_scan[:scans]), iter(by_scan[scans:]),
        iter(poses), iter(Q))


def _records(
    robot: str, events: Iterable[tuple[int, int]], landmark_scans: Iterator[Any],
    robot_scans: Iterator[Any], poses: Iterator[Array], covariances: Iterator[Array],
) -> list[Measurement]:
    """Return the records of events (kind, stamp), each with the next content of its kind."""
    records: list[Measurement] = []
    for kind, stamp in events:
        if kind in _SCANS:
            records.append(_SCANS[kind](robot, stamp, next(landmark_scans)))
        elif kind in _ROBOT_SCANS:
            records.append(_ROBOT_SCANS[kind](robot, stamp, next(robot_scans)))
        else:
            covariance = next(covariances) if kind == _WITH_COVARIANCE else None
            records.append(Odometry(robot, stamp, next(poses), covariance))
    return records


class _Columns:
    """The columns of a block, in their order."""

    def __init__(self, block: bytes) -> None:
        stream = zlib.decompressobj()
        try:
            self._content = stream.decompress(block, MAX_CONTENT)
        except zlib.error as error:
            raise BadBlockError(str(error)) from error
        _require(stream.eof and not stream.unused_data)
        self._at = 0

    def take(self, dtype: str, count: int) -> NDArray[Any]:
        """Return the next numbers."""
        size = np.dtype(dtype).itemsize
        end = self._at + size * count
        _require(end <= len(self._content))
        byte_rows = np.frombuffer(self._content[self._at:end], 'u1').reshape(size, count)
        self._at = end
        return np.ascontiguousarray(byte_rows.T).view(dtype).ravel()

    def end(self) -> None:
        """Check that no bytes remain."""
        _require(self._at == len(self._content))


def _kind(record: Measurement) -> int:
    if isinstance(record, Odometry):
        return _WITHOUT_COVARIANCE if record.twist_covariance is None else _WITH_COVARIANCE
    return _KIND_OF[type(record)]


def _bytes_by_significance(column: NDArray[Any]) -> bytes:
    """Return the bytes of numbers, the first of each before the second of each."""
    flat = np.ascontiguousarray(column).ravel()
    return flat.view('u1').reshape(len(flat), flat.itemsize).T.tobytes()


def _names(text: bytes) -> list[str]:
    try:
        return text.decode().split('\0') if text else []
    except UnicodeDecodeError as error:
        raise BadBlockError(str(error)) from error


def _check(poses: Array, Q: Array, z: Array, R: Array) -> None:
    """Raise a BadBlockError unless numbers are finite, and covariances definite."""
    for values in (poses, Q, z, R):
        _require(bool(np.isfinite(values).all()))
        _require(float(np.abs(values).max(initial=0.0)) <= MAX_VALUE)
    for P in (Q, R):
        skew = np.abs(P - P.transpose(0, 2, 1))
        _require(bool((skew <= SYMMETRY * np.abs(P).max(axis=(1, 2), keepdims=True)).all()))
    _require(all(map(has_information, Q)))
    # Robots use observations that are almost exact in one direction, and others have to read them.
    try:
        np.linalg.cholesky(R)
    except np.linalg.LinAlgError as error:
        raise BadBlockError(str(error)) from error


def _require(condition: bool) -> None:
    if not condition:
        raise BadBlockError('its content is not that of a block')
