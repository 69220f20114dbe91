# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The raw log of Victoria Park: wheels, tree detections and GPS, each with stamps of its own.

The folder holds ``aa3_dr.mat`` and ``aa3_gpsx.mat`` of Guivant and Nebot, and ``detections.csv``
and ``scan_time.csv``, in which the trees are that their detector found in the scans. Which tree
each detection is, the log does not tell; ``data_sensor_clean_clean.mat`` of OpenSLAM's 2D I-SLSJF
does, of nine in ten.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.datasets.file_errors import blaming, require_folder
from fej_slam_ros.datasets.matlab import matrices
from fej_slam_ros.errors import UserError

Integers = NDArray[np.int64]

#: Nanoseconds in a unit of the files' stamps.
MS = 1_000_000
#: A detection of which no file tells what tree it is.
UNKNOWN = -1
#: The file with the identities is rounded to 5 digits [m, rad].
ROUNDING = 2e-5
#: The front wheels turn no farther [rad].
MAX_STEERING = 1.0

WHEELS = ('time', 'speed', 'steering')
FIXES = ('timeGps', 'Lo_m', 'La_m')
SCANS = ('scan', 't_ms')
DETECTIONS = ('scan', 't_ms', 'range_m', 'bearing_rad', 'diameter_m')
IDENTITIES = 'data_sensor_clean_clean'


@dataclass(frozen=True, slots=True, eq=False)
class Wheels:
    """Stamps (n,) [ns], and from each on the speed of the encoder wheel [m/s] and the steering."""

    stamps: Integers
    speed: Array
    steering: Array

    def between(self, first: int, last: int) -> 'Wheels':
        """Return the part that reaches over two stamps [ns]."""
        a = max(np.searchsorted(self.stamps, first, side='right') - 1, 0)
        b = np.searchsorted(self.stamps, last) + 1
        return Wheels(self.stamps[a:b], self.speed[a:b], self.steering[a:b])


@dataclass(frozen=True, slots=True, eq=False)
class Scans:
    """
    The trees in each scan.

    Attributes
    ----------
    stamps : (s,) array [ns]
    starts : (s + 1,) array, the detections of scan k are those from starts[k] to starts[k + 1]
    ranges, bearings : (m,) arrays, to the tree's centre [m], and from the laser's right [rad]
    ids : (m,) array, which tree it is, `UNKNOWN` where that is not known

    """

    stamps: Integers
    starts: Integers
    ranges: Array
    bearings: Array
    ids: Integers

    def between(self, first: int, last: int) -> 'Scans':
        """Return the scans from one stamp to another [ns]."""
        a, b = np.searchsorted(self.stamps, (first, last + 1))
        starts = self.starts[a:b + 1]
        of_part = slice(starts[0], starts[-1])
        return Scans(
            self.stamps[a:b], starts - starts[0], self.ranges[of_part], self.bearings[of_part],
            self.ids[of_part])


@dataclass(frozen=True, slots=True, eq=False)
class Fixes:
    """Stamps (g,) [ns] and where GPS had its antenna (g, 2), east and north [m]."""

    stamps: Integers
    points: Array

    def between(self, first: int, last: int) -> 'Fixes':
        """Return the fixes from one stamp to another [ns]."""
        a, b = np.searchsorted(self.stamps, (first, last + 1))
        return Fixes(self.stamps[a:b], self.points[a:b])


@dataclass(frozen=True, slots=True, eq=False)
class RawLog:
    """All that the car measured, on one clock."""

    wheels: Wheels
    scans: Scans
    fixes: Fixes

    def between(self, first: int, last: int) -> 'RawLog':
        """Return the log from one stamp to another [ns]."""
        return RawLog(
            self.wheels.between(first, last), self.scans.between(first, last),
            self.fixes.between(first, last))

    def later(self, by: int) -> 'RawLog':
        """Return the log as if everything had been so much later [ns]."""
        return RawLog(
            replace(self.wheels, stamps=self.wheels.stamps + by),
            replace(self.scans, stamps=self.scans.stamps + by),
            replace(self.fixes, stamps=self.fixes.stamps + by))


def read(folder: Path) -> RawLog:
    """
    Return the log in a folder; no tree has an identity.

    Raises
    ------
    UserError
        A file is missing or damaged.

    """
    require_folder(folder, 'the Victoria Park data')
    return RawLog(
        _wheels(folder / 'aa3_dr.mat'),
        _scans(folder / 'scan_time.csv', folder / 'detections.csv'),
        _fixes(folder / 'aa3_gpsx.mat'))


def identified(scans: Scans, path: Path) -> Scans:
    """
    Return the scans with the identities in a file, matched by stamp, range and bearing.

    Raises
    ------
    UserError
        The file is missing or damaged, or belongs to other scans.

    """
    with blaming(path):
        rows = _variables(path, {IDENTITIES: 6})[0]
        _require_finite(rows)
        stamps, numbers = np.rint(rows[:, 0] * MS).astype(np.int64), rows[:, 5]
        if ((numbers != np.floor(numbers)) | (numbers < 0) | (numbers >= 2**31)).any():
            raise UserError('a tree has an id that is not an integer from 0 to 2147483647')
        if len(np.unique(rows[:, [0, 5]], axis=0)) < len(rows):
            raise UserError('a scan sees one tree twice')
        ids = np.full(len(scans.ids), UNKNOWN)
        order = np.argsort(stamps, kind='stable')
        for of_scan in np.split(order, np.flatnonzero(np.diff(stamps[order])) + 1):
            ids[_matched(scans, stamps[of_scan[0]], rows[of_scan, 1:3])] = numbers[of_scan]
    return replace(scans, ids=ids)


def _matched(scans: Scans, stamp: int, seen: Array) -> Integers:
    """Return which detections of the scan at a stamp have the ranges and bearings (k, 2)."""
    k = int(np.searchsorted(scans.stamps, stamp))
    if k == len(scans.stamps) or scans.stamps[k] != stamp:
        raise UserError(f'there was no scan at {stamp // MS} ms')
    first, after = scans.starts[k:k + 2]
    there = np.column_stack([scans.ranges[first:after], scans.bearings[first:after]])
    is_same = (np.abs(seen[:, None] - there) < ROUNDING).all(axis=2)
    if (is_same.sum(axis=1) != 1).any() or (is_same.sum(axis=0) > 1).any():
        raise UserError(f'a row of the scan at {stamp // MS} ms is not one of its detections')
    found: Integers = first + is_same.argmax(axis=1)
    return found


def _wheels(path: Path) -> Wheels:
    with blaming(path):
        time, speed, steering = _columns(path, WHEELS)
        if (np.abs(steering) > MAX_STEERING).any():
            raise UserError(f'the wheels are steered by more than {MAX_STEERING:g} rad')
        return Wheels(_stamps(time), speed, steering)


def _fixes(path: Path) -> Fixes:
    with blaming(path):
        time, east, north = _columns(path, FIXES)
        return Fixes(_stamps(time), np.column_stack([east, north]))


def _scans(times: Path, detections: Path) -> Scans:
    with blaming(times):
        numbers, time = _table(times, SCANS)
        if (numbers != np.arange(len(numbers))).any():
            raise UserError('the scans do not go from 0 to 1 and so on')
        stamps = _stamps(time)
    with blaming(detections):
        of_scan, time, ranges, bearings, _ = _table(detections, DETECTIONS)
        if not np.isin(of_scan, numbers).all() or (np.diff(of_scan) < 0).any():
            raise UserError(f'the scans do not go up from 0 to {len(numbers) - 1}')
        if (np.rint(time * MS) != stamps[of_scan.astype(int)]).any():
            raise UserError(f'a scan has another stamp than in {times.name}')
        if not (ranges > 0.0).all():
            raise UserError('a range is not positive')
    starts = np.searchsorted(of_scan, np.arange(len(numbers) + 1))
    return Scans(stamps, starts, ranges, bearings, np.full(len(ranges), UNKNOWN))


def _columns(path: Path, names: Sequence[str]) -> list[Array]:
    """Return variables of a MATLAB file that go row by row."""
    columns = [column.ravel() for column in _variables(path, dict.fromkeys(names, 1))]
    if len({len(column) for column in columns}) > 1:
        raise UserError(f'{", ".join(names)} are not of one length')
    _require_finite(*columns)
    return columns


def _variables(path: Path, columns: dict[str, int]) -> list[Array]:
    _require(path)
    found = matrices(path, columns)
    for name in columns:
        if name not in found:
            raise UserError(f'the variable {name} is not in it')
    return [found[name] for name in columns]


def _table(path: Path, names: Sequence[str]) -> list[Array]:
    """Return the columns of a file of comma-separated values."""
    _require(path)
    try:
        head, *lines = path.read_text('ascii').splitlines()
        rows = np.array([line.split(',') for line in lines], dtype=float)
        rows = rows.reshape(len(lines), len(names))
    except ValueError as error:
        raise UserError(f'cannot be read as a table ({error})') from error
    if head != ','.join(names):
        raise UserError(f'its first line is not {",".join(names)}')
    _require_finite(rows)
    return list(rows.T)


def _stamps(ms: Array) -> Integers:
    """Return stamps [ns], of which there must be some, in order."""
    if not len(ms):
        raise UserError('there is nothing in it')
    stamps = np.rint(ms * MS).astype(np.int64)
    if not (np.diff(stamps) > 0).all() or stamps[0] < 0:
        raise UserError('its times do not go up')
    return stamps


def _require(path: Path) -> None:
    if not path.is_file():
        raise UserError('there is no such file of the raw log')


def _require_finite(*columns: Array) -> None:
    if not all(np.isfinite(column).all() for column in columns):
        raise UserError('a value is not finite')
