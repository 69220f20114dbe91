# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The raw log of Victoria Park: wheels, tree detections and GPS, each with stamps of its own.

The folder holds ``aa3_dr.mat`` and ``aa3_gpsx.mat`` of Guivant and Nebot, and ``detections.csv``
and ``scan_time.csv`` with the trees that their detector found in the scans. Detections have no
tree IDs; ``data_sensor_clean_clean.mat`` of OpenSLAM's 2D I-SLSJF has the ID of nine in ten.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID, NS
from fej_slam_ros.datasets.file_checks import (
    errors_name, LAST_SECOND, require_finite, require_folder, require_landmark_ids)
from fej_slam_ros.datasets.matlab import required_matrices
from fej_slam_ros.datasets.series import Series
from fej_slam_ros.errors import UserError

Integers = NDArray[np.int64]
#: Nanoseconds in a unit of the files' stamps.
MS = 1_000_000
#: Tolerance for matching a detection with the file of IDs, whose values have 5 digits [m, rad].
MATCH_TOLERANCE = 2e-5
#: Maximum steering angle of the front wheels [rad], speed [m/s], range [m] and bearing [rad].
MAX_STEERING, MAX_SPEED = 1.0, 100.0
MAX_RANGE, MAX_BEARING = 1000.0, 7.0
WHEEL_VARIABLES = ('time', 'speed', 'steering')
FIX_VARIABLES = ('timeGps', 'Lo_m', 'La_m')
SCAN_COLUMNS = ('scan', 't_ms')
DETECTION_COLUMNS = ('scan', 't_ms', 'range_m', 'bearing_rad', 'diameter_m')
ID_VARIABLE = 'data_sensor_clean_clean'


@dataclass(frozen=True, slots=True, eq=False)
class TreeScans:
    """Tree detections by scan."""

    stamps: Integers  #: (s,) array [ns]
    #: (s + 1,) array, scan k has the detections from starts[k] up to starts[k + 1].
    starts: Integers
    #: (m,) arrays, to the tree's centre [m], and from the laser's right [rad].
    ranges: Array
    bearings: Array
    ids: Integers  #: (m,) array, tree IDs, `NO_ID` if unknown

    def between(self, first: int, last: int) -> 'TreeScans':
        """Return the scans from one stamp to another [ns]."""
        a, b = np.searchsorted(self.stamps, (first, last + 1))
        starts = self.starts[a:b + 1]
        part = slice(starts[0], starts[-1])
        return TreeScans(
            self.stamps[a:b], starts - starts[0], self.ranges[part], self.bearings[part],
            self.ids[part])


@dataclass(frozen=True, slots=True, eq=False)
class RawLog:
    """All measurements of the car, on one clock."""

    wheels: Series  #: from each stamp on, speed of the encoder wheel [m/s] and steering [rad]
    trees: TreeScans
    fixes: Series  #: antenna positions by GPS (g, 2), east and north [m]

    def between(self, first: int, last: int) -> 'RawLog':
        """Return the log from one stamp to another [ns], with the wheels of all this time."""
        begin = max(np.searchsorted(self.wheels.stamps, first, side='right') - 1, 0)
        end = np.searchsorted(self.wheels.stamps, last) + 1
        return RawLog(
            self.wheels[begin:end], self.trees.between(first, last),
            self.fixes.between(first, last))

    def shifted(self, offset: int) -> 'RawLog':
        """Return the log with an offset added to all stamps [ns]."""
        return RawLog(
            self.wheels.shifted(offset),
            replace(self.trees, stamps=self.trees.stamps + offset),
            self.fixes.shifted(offset))


def read(folder: Path) -> RawLog:
    """Return the log in a folder, without tree IDs."""
    require_folder(folder, 'the Victoria Park data')
    wheel_file, fix_file = folder / 'aa3_dr.mat', folder / 'aa3_gpsx.mat'
    with errors_name(wheel_file):
        of_wheels = wheels(*_columns(wheel_file, WHEEL_VARIABLES))
    trees = _trees(folder / 'scan_time.csv', folder / 'detections.csv')
    with errors_name(fix_file):
        of_antenna = fixes(*_columns(fix_file, FIX_VARIABLES))
    return RawLog(of_wheels, trees, of_antenna)


def with_ids(trees: TreeScans, path: Path) -> TreeScans:
    """Return the scans with the tree IDs in a file, matched by stamp, range and bearing."""
    with errors_name(path):
        rows = required_matrices(path, {ID_VARIABLE: 6})[ID_VARIABLE]
        stamps, tree_ids = np.rint(rows[:, 0] * MS).astype(np.int64), rows[:, 5]
        require_landmark_ids(rows[:, 0], tree_ids)
        ids = np.full(len(trees.ids), NO_ID)
        order = np.argsort(stamps, kind='stable')
        for of_scan in np.split(order, np.flatnonzero(np.diff(stamps[order])) + 1):
            ids[_matched(trees, stamps[of_scan[0]], rows[of_scan, 1:3])] = tree_ids[of_scan]
    return replace(trees, ids=ids)


def _matched(trees: TreeScans, stamp: int, measured: Array) -> Integers:
    """Return the detections of the scan at a stamp with the ranges and bearings (k, 2)."""
    k = int(np.searchsorted(trees.stamps, stamp))
    if k == len(trees.stamps) or trees.stamps[k] != stamp:
        raise UserError(f'there was no scan at {stamp // MS} ms')
    first, after = trees.starts[k:k + 2]
    detections = np.column_stack([trees.ranges[first:after], trees.bearings[first:after]])
    is_same = (np.abs(measured[:, None] - detections) < MATCH_TOLERANCE).all(axis=2)
    if (is_same.sum(axis=1) != 1).any() or (is_same.sum(axis=0) > 1).any():
        raise UserError(f'a row of the scan at {stamp // MS} ms is not one of its detections')
    matched: Integers = first + is_same.argmax(axis=1)
    return matched


def wheels(time: Array, speed: Array, steering: Array) -> Series:
    """Return rows of times [ms], speeds [m/s] and steering angles [rad], checked."""
    if (np.abs(steering) > MAX_STEERING).any():
        raise UserError(f'the steering exceeds {MAX_STEERING:g} rad')
    if (np.abs(speed) > MAX_SPEED).any():
        raise UserError(f'the speed exceeds {MAX_SPEED:g} m/s')
    return Series(increasing_stamps(time), np.column_stack([speed, steering]))


def fixes(time: Array, east: Array, north: Array) -> Series:
    """Return rows of times [ms] and antenna positions [m], checked."""
    return Series(increasing_stamps(time), np.column_stack([east, north]))


def require_possible(ranges: Array, bearings: Array) -> None:
    """Raise a `UserError` if a range is not positive, or a value is too large."""
    if not (ranges > 0.0).all():
        raise UserError('a range is not positive')
    if (ranges > MAX_RANGE).any() or (np.abs(bearings) > MAX_BEARING).any():
        raise UserError(f'a range exceeds {MAX_RANGE:g} m or a bearing {MAX_BEARING:g} rad')


def increasing_stamps(ms: Array) -> Integers:
    """Return stamps [ns], which must increase, from times [ms]."""
    if not len(ms):
        raise UserError('it has no rows')
    if (np.abs(ms) > LAST_SECOND * NS / MS).any():
        raise UserError(f'a time is after {LAST_SECOND} s')
    stamps = np.rint(ms * MS).astype(np.int64)
    if not (np.diff(stamps) > 0).all() or stamps[0] < 0:
        raise UserError('its times do not increase')
    return stamps


def _trees(times: Path, detections: Path) -> TreeScans:
    with errors_name(times):
        scans, time = _table(times, SCAN_COLUMNS)
        if (scans != np.arange(len(scans))).any():
            raise UserError('the scans are not numbered 0, 1 and so on')
        stamps = increasing_stamps(time)
    with errors_name(detections):
        scan_of, time, ranges, bearings, _ = _table(detections, DETECTION_COLUMNS)
        if not np.isin(scan_of, scans).all() or (np.diff(scan_of) < 0).any():
            raise UserError(f'the scans do not go up from 0 to {len(scans) - 1}')
        if (np.rint(time * MS) != stamps[scan_of.astype(int)]).any():
            raise UserError(f'a scan has another stamp than in {times.name}')
        require_possible(ranges, bearings)
    starts = np.searchsorted(scan_of, np.arange(len(scans) + 1))
    return TreeScans(stamps, starts, ranges, bearings, np.full(len(ranges), NO_ID))


def _columns(path: Path, names: Sequence[str]) -> list[Array]:
    """Return variables of a MATLAB file that are columns of one length."""
    matrices = required_matrices(path, dict.fromkeys(names, 1))
    columns = [column.ravel() for column in matrices.values()]
    if len({len(column) for column in columns}) > 1:
        raise UserError(f'{", ".join(names)} are not of one length')
    return columns


def _table(path: Path, names: Sequence[str]) -> list[Array]:
    """Return the columns of a file of comma-separated values."""
    try:
        head, *lines = path.read_text('ascii').splitlines()
        rows = np.array([line.split(',') for line in lines], dtype=float)
        rows = rows.reshape(len(lines), len(names))
    except ValueError as error:
        raise UserError(f'cannot be read as a table ({error})') from error
    if head != ','.join(names):
        raise UserError(f'its first line is not {",".join(names)}')
    require_finite(rows)
    return list(rows.T)
