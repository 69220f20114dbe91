# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
MRCLAM, the UTIAS sets of five robots among fifteen landmarks: files to logs of what they measured.

A set is a folder of text files: what each robot was commanded, which bar codes it saw, and where
motion capture had it. Rows that cannot be right are left out, and counted by the reason.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.geometry import Array, Flags, wrap_all
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.file_errors import require_folder
from fej_slam_ros.errors import UserError

Stamps = NDArray[np.int64]

#: Subjects that are robots; all others are landmarks.
ROBOTS = range(1, 6)

#: A float holds the seconds of the files to a microsecond, and a bag takes no more than an int32.
TICKS = 1_000_000
LAST_SECOND = 2**31 - 1

#: Motion capture that moves and turns faster than FASTER times what was ever commanded, by more
#: than its noise [m, m, rad], has slipped; it is not used within SLIP_MARGIN [ns] of that.
FASTER = 1.25
TRUTH_NOISE = np.array([0.02, 0.02, 0.02])
SLIP_MARGIN = NS // 4


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Rows (n, c) and their stamps (n,) [ns], which never decrease."""

    stamps: Stamps
    rows: Array

    def __len__(self) -> int:
        return len(self.stamps)

    def where(self, wanted: Flags) -> 'Series':
        """Return some of the rows."""
        return Series(self.stamps[wanted], self.rows[wanted])


@dataclass(frozen=True, slots=True, eq=False)
class RobotLog:
    """
    What one robot measured.

    Attributes
    ----------
    commands : speeds ahead [m/s] and to the left [rad/s], each in force until the next
    observations : subject, range [m], bearing [rad, to the left]
    truth : true poses [x, y, phi]; none where there was no motion capture
    counts : how many rows are not used, or were not in order, by the reason

    """

    commands: Series
    observations: Series
    truth: Series
    counts: Counter[str]


@dataclass(frozen=True, slots=True, eq=False)
class DataSet:
    """
    What a folder holds.

    Attributes
    ----------
    logs : of the robots that have odometry from one stamp to another, by subject
    landmarks : true positions (2,), by subject
    landmark_file : name of the file that these are from, '' for none

    """

    logs: Mapping[int, RobotLog]
    landmarks: Mapping[int, Array]
    landmark_file: str


def read(folder: Path) -> DataSet:
    """
    Return the set in a folder.

    Raises
    ------
    UserError
        There is no such folder, or no bar codes or no odometry in it.

    """
    require_folder(folder, 'the files of an MRCLAM set')
    codes = _codes(folder / 'Barcodes.dat')
    logs = {robot: _log(folder, robot, codes) for robot in ROBOTS}
    here = {robot: log for robot, log in logs.items() if len(log.commands) > 1}
    if not here:
        raise UserError(
            f'{folder} holds no odometry of any robot: put Robot1_Odometry.dat and so on there,'
            ' with rows of time [s], v [m/s], w [rad/s]')
    return DataSet(here, *_landmarks(folder))


def _codes(path: Path) -> dict[int, int]:
    """Return the subject of each bar code."""
    rows, _ = _table(path, 2)
    if not len(rows):
        raise UserError(
            f'{path} is missing or names no bar code: give the folder with all files of an MRCLAM'
            ' set')
    return {int(code): int(subject) for subject, code in rows}


def _landmarks(folder: Path) -> tuple[dict[int, Array], str]:
    """Return true positions and the file that they are from: of both the corrected one."""
    for name in ('Landmark_Groundtruth_fixed.dat', 'Landmark_Groundtruth.dat'):
        rows, _ = _table(folder / name, 3, 5)
        if len(rows):
            return {int(row[0]): row[1:3] for row in rows}, name
    return {}, ''


def _log(folder: Path, robot: int, codes: Mapping[int, int]) -> RobotLog:
    counts: Counter[str] = Counter()
    commands = _last_at_its_stamp(
        _series(folder / f'Robot{robot}_Odometry.dat', 3, counts), counts)
    seen = _series(folder / f'Robot{robot}_Measurement.dat', 4, counts)
    truth = _series(folder / f'Robot{robot}_Groundtruth.dat', 4, counts)
    if not len(truth):
        truth = _sparse_truth(folder / 'sparse_truth.csv', robot, counts)
    return RobotLog(
        commands, _identified(seen, robot, codes, counts), _unslipped(truth, commands, counts),
        counts)


def _identified(
    seen: Series, robot: int, codes: Mapping[int, int], counts: Counter[str]
) -> Series:
    """Return observations with subjects in place of bar codes, without the impossible ones."""
    # Not in place: some codes are another one's subject.
    subjects = np.array([codes.get(code, -1) for code in seen.rows[:, 0].tolist()], dtype=float)
    found = Series(seen.stamps, np.column_stack([subjects, seen.rows[:, 1:]]))
    found = _drop(found, found.rows[:, 0] < 0, 'unknown bar code', counts)
    found = _drop(found, found.rows[:, 0] == robot, 'observation of itself', counts)
    beyond = (found.rows[:, 1] <= 0.0) | (np.abs(found.rows[:, 2]) > math.pi)
    found = _drop(found, beyond, 'impossible range or bearing', counts)
    again = np.ones(len(found), dtype=bool)
    names = np.column_stack([found.stamps, found.rows[:, 0].astype(np.int64)])
    again[np.unique(names, axis=0, return_index=True)[1]] = False
    return _drop(found, again, 'seen twice in one scan', counts)


def _last_at_its_stamp(commands: Series, counts: Counter[str]) -> Series:
    """Return the commands that were in force for some time."""
    ended = np.diff(commands.stamps, append=LAST_SECOND * NS) == 0
    return _drop(commands, ended, 'command replaced at its own stamp', counts)


def _unslipped(truth: Series, commands: Series, counts: Counter[str]) -> Series:
    """Return true poses, one for each stamp, without those around jumps that no robot can make."""
    again = np.diff(truth.stamps, prepend=-1) == 0
    truth = _drop(truth, again, 'truth repeated at one stamp', counts)
    if not len(commands):
        return truth
    v, w = FASTER * np.abs(commands.rows).max(axis=0)
    steps, dt = np.abs(np.diff(truth.rows, axis=0)), np.diff(truth.stamps) / NS
    steps[:, 2] = np.abs(wrap_all(np.diff(truth.rows[:, 2])))
    jumps = (steps > TRUTH_NOISE + dt[:, None] * [v, v, w]).any(axis=1)
    # The pose before the jump may be wrong, or the one behind it.
    begins, ends = truth.stamps[:-1][jumps] - SLIP_MARGIN, truth.stamps[1:][jumps] + SLIP_MARGIN
    inside = np.searchsorted(begins, truth.stamps) - np.searchsorted(ends, truth.stamps, 'right')
    return _drop(truth, inside > 0, 'truth at a jump', counts)


def _drop(series: Series, unwanted: Flags, reason: str, counts: Counter[str]) -> Series:
    """Return a series without some of its rows, which are counted."""
    counts[reason] += int(unwanted.sum())
    return series.where(~unwanted)


def _sparse_truth(path: Path, robot: int, counts: Counter[str]) -> Series:
    """Return the few poses that are known of a robot without a file of motion capture."""
    rows, _ = _table(path, 5, 6)
    return _in_order(rows[rows[:, 0] == robot, 1:], counts)


def _series(path: Path, columns: int, counts: Counter[str]) -> Series:
    """Return a file of rows that begin with their time, in its order; nothing for no file."""
    rows, broken = _table(path, columns)
    counts['broken row'] += broken
    return _in_order(rows, counts)


def _in_order(rows: Array, counts: Counter[str]) -> Series:
    """Return rows that begin with their time [s] by their stamps."""
    possible = (rows[:, 0] >= 0.0) & (rows[:, 0] < LAST_SECOND)
    counts['broken row'] += int((~possible).sum())
    rows = rows[possible]
    stamps: Stamps = np.rint(rows[:, 0] * TICKS).astype(np.int64) * (NS // TICKS)
    counts['stamp steps back (put in order)'] += int((np.diff(stamps) < 0).sum())
    order = np.argsort(stamps, kind='stable')
    return Series(stamps[order], rows[order, 1:])


def _table(path: Path, columns: int, most: int = 0) -> tuple[Array, int]:
    """
    Return rows (n, columns) of the numbers in a file, none for no file, and how many are broken.

    A row has exactly so many columns, or more up to `most`, which are left out.

    """
    text = path.read_text(encoding='utf-8-sig', errors='replace') if path.is_file() else ''
    lines = (line.partition('#')[0] for line in text.splitlines())
    rows = [_numbers(line) for line in lines if line.strip()]
    whole = [row[:columns] for row in rows if columns <= len(row) <= max(columns, most)]
    return np.array(whole).reshape(-1, columns), len(rows) - len(whole)


def _numbers(line: str) -> list[float]:
    """Return the finite numbers of a line that white space or commas part; none if not all are."""
    try:
        values = [float(word) for word in line.replace(',', ' ').split()]
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []
