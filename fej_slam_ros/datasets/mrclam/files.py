# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
MRCLAM, the UTIAS data sets of five robots and fifteen landmarks: files to logs of each robot.

A set is a folder of text files: the commands of each robot, the bar codes that it observed, and
its true poses by motion capture. Impossible rows are dropped and counted by reason.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
import math
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Stamps, wrap_all
from fej_slam_ros.core.records import MAX_ID, NS
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.datasets.file_checks import LAST_SECOND, require_folder
from fej_slam_ros.datasets.mrclam.clock_evidence import ClockEvidence
from fej_slam_ros.datasets.mrclam.clock_parts import ClockPart, MAX_STEP
from fej_slam_ros.datasets.mrclam.clocks import in_order, may_be_set
from fej_slam_ros.datasets.mrclam.motion_capture import without_slips
from fej_slam_ros.datasets.series import drop, Series
from fej_slam_ros.errors import UserError

#: Subjects that are robots; all others are landmarks.
ROBOT_SUBJECTS = range(1, 6)
#: Stamps are rounded to microseconds, which a float of the files' seconds resolves.
TICKS = 1_000_000
#: Speeds [m/s, rad/s] beyond which the estimator takes odometry for that of a restarted driver.
MAX_SPEEDS = np.array([RobotSettings.max_speed, RobotSettings.max_turn_rate])
#: Largest range [m], beyond that of any camera.
MAX_RANGE = 1e5
#: Longest time [ns] between a row and most commands of its robot: a set lasts less than a day, and
#: a clock that was not set begins in 1970.
MAX_DISTANCE = 24 * 3600 * NS
#: Maximum number of successive commands whose stamps are damaged; more are of another clock.
MAX_STRAYS = 10
#: Number of impossible observations of a robot up to which these are no mistaken unit.
MAX_IMPOSSIBLE = 10
FAR_STAMP = 'stamp far from those of other rows'
UNKNOWN_CODE = 'unknown bar code'
REPLACED_COMMAND = 'command replaced at its own stamp'


@dataclass(frozen=True, slots=True, eq=False)
class RobotLog:
    """Measurements of one robot."""

    robot: int  #: Its subject
    #: Forward speed [m/s] and turn rate [rad/s, left], each in force until the next.
    commands: Series
    observations: Series  #: Subject, range [m], bearing [rad, left]
    truth: Series  #: True poses [x, y, phi]; empty without motion capture
    counts: Counter[str]  #: Number of rows that were dropped or out of order, by reason
    #: Stamps of the first commands after another clock, before which motion may be missing
    clock_changes: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class MrclamSet:
    """Contents of a folder."""

    logs: Mapping[int, RobotLog]  #: Of the robots with at least two rows of odometry, by subject
    landmarks: Mapping[int, Array]  #: True positions (2,), by subject
    landmark_file: str  #: Name of their file, '' for none
    incomplete: Mapping[int, Counter[str]]  #: Counts of the other robots' logs, by subject
    broken_rows: Counter[str]  #: Number of broken rows in the files of all robots, by name


def read(folder: Path) -> MrclamSet:
    """Return the set in a folder, which must hold bar codes and the odometry of a robot."""
    require_folder(folder, 'the files of an MRCLAM set')
    _require_known_robots(folder)
    broken: Counter[str] = Counter()
    codes = _subjects_by_code(folder / 'Barcodes.dat', broken)
    sparse_truth = _table(folder / 'sparse_truth.csv', 5, broken, max_columns=6)
    logs = _logs([
        _recorded(folder, robot, codes, sparse_truth[sparse_truth[:, 0] == robot, 1:])
        for robot in ROBOT_SUBJECTS])
    complete = {log.robot: log for log in logs if len(log.commands) > 1}
    if not complete:
        unread = ''.join(
            f'; {log.counts["broken row"]} rows of robot {log.robot} are no such numbers'
            for log in logs[:1] if log.counts['broken row'])
        raise UserError(
            f'{folder} holds no odometry of any robot: put Robot1_Odometry.dat and so on there,'
            f' with rows of time [s], v [m/s], w [rad/s], separated by spaces{unread}')
    incomplete = {log.robot: _unused(log) for log in logs if log.robot not in complete}
    return MrclamSet(complete, *_landmarks(folder, broken), incomplete, broken)


def _subjects_by_code(path: Path, broken: Counter[str]) -> dict[int, int]:
    rows = _of_subjects(_table(path, 2, broken), path, broken)
    if not len(rows):
        raise UserError(
            f'{path} has no row of two numbers, subject and bar code, separated by spaces'
            if broken[path.name] else
            f'{path} is missing or has no bar codes: give the folder with all files of an MRCLAM'
            ' set')
    rows = np.unique(rows, axis=0)
    codes, counts = np.unique(rows[:, 1], return_counts=True)
    if counts.max() > 1:
        code = codes[counts.argmax()]
        subjects = ' and '.join(f'{subject:g}' for subject in rows[rows[:, 1] == code, 0])
        raise UserError(
            f'{path} gives bar code {code:g} to subjects {subjects}: correct it, or remove the'
            ' rows, and observations of this code are left out')
    return {int(code): int(subject) for subject, code in rows}


def _require_known_robots(folder: Path) -> None:
    """Raise a `UserError` if there is a robot whose observations would be those of a landmark."""
    known = {f'Robot{robot}_Odometry.dat' for robot in ROBOT_SUBJECTS}
    others = sorted({path.name for path in folder.glob('Robot*_Odometry.dat')} - known)
    if others:
        raise UserError(
            f'{folder} holds {others[0]}: the robots of a set are the subjects'
            f' {ROBOT_SUBJECTS[0]} to {ROBOT_SUBJECTS[-1]}, all others are landmarks; give the'
            ' robots these numbers, or write CSV tables for convert csv')


def _landmarks(folder: Path, broken: Counter[str]) -> tuple[dict[int, Array], str]:
    """Return true positions and the name of their file; the corrected file is preferred."""
    for name in ('Landmark_Groundtruth_fixed.dat', 'Landmark_Groundtruth.dat'):
        rows = _table(folder / name, 3, broken, max_columns=5)
        rows = np.unique(_of_subjects(rows, folder / name, broken), axis=0)
        subjects, counts = np.unique(rows[:, 0], return_counts=True)
        if len(subjects) < len(rows):
            raise UserError(
                f'{folder / name} gives subject {subjects[counts.argmax()]:g} several positions:'
                ' keep one')
        if len(rows):
            return {int(row[0]): row[1:3] for row in rows}, name
    return {}, ''


def _recorded(
    folder: Path, robot: int, codes: Mapping[int, int], sparse_truth: Array
) -> RobotLog:
    """
    Return the rows of a robot in the order of recording.

    Its sparse true poses (n, 4), which begin with the time [s], are used without motion capture.
    """
    counts: Counter[str] = Counter()
    truth = _series(folder / f'Robot{robot}_Groundtruth.dat', 4, counts)
    if not len(truth):
        truth = _stamped(sparse_truth, counts)
    counts['stamp steps back (put in order)'] += int((np.diff(truth.stamps) < 0).sum())
    commands = _series(folder / f'Robot{robot}_Odometry.dat', 3, counts)
    impossible: Flags = np.any(np.abs(commands.rows) > MAX_SPEEDS, axis=1)
    commands = drop(commands, impossible, 'impossible command', counts)
    observations = _identified(
        _series(folder / f'Robot{robot}_Measurement.dat', 4, counts), robot, codes, counts)
    commands, observations = _without_far_stamps(commands, observations, counts)
    return RobotLog(robot, commands, observations, truth.in_order(), counts)


def _without_far_stamps(
    commands: Series, observations: Series, counts: Counter[str]
) -> tuple[Series, Series]:
    """Return commands and observations without those of clocks not set and damaged stamps."""
    if len(commands):
        middle = np.sort(commands.stamps)[len(commands) // 2]
        commands, observations = (
            drop(series, np.abs(series.stamps - middle) > MAX_DISTANCE, FAR_STAMP, counts)
            for series in (commands, observations))
    return drop(commands, _strays(commands.stamps), FAR_STAMP, counts), observations


def _strays(stamps: Stamps) -> Flags:
    """Return which rows are far in time from the rows before and after, which go on."""
    strays = np.zeros(len(stamps), dtype=bool)
    jumps = np.flatnonzero(np.abs(np.diff(stamps)) > MAX_STEP) + 1
    for begin, end in pairwise(jumps.tolist()):
        returns = 0 <= stamps[end] - stamps[begin - 1] <= MAX_STEP
        # Rows between two groups with the same damage return to it, too.
        strays[begin:end] = returns and end - begin <= MAX_STRAYS and not strays[begin - 1]
    return strays


def _logs(recorded: Sequence[RobotLog]) -> list[RobotLog]:
    """Return logs in the order of stamps; set clocks come last, as others may correct them."""
    ordered: dict[int, ClockPart] = {}
    by_doubt = sorted(
        recorded, key=lambda log: (may_be_set(log.commands.stamps), -len(log.truth)))
    for log in by_doubt:
        evidence = ClockEvidence(log.truth, ROBOT_SUBJECTS, log.robot, {
            robot: part for robot, part in ordered.items() if len(part.commands) > 1})
        ordered[log.robot] = in_order(log.commands, log.observations, evidence, log.counts)
    return [_checked(log, ordered[log.robot]) for log in recorded]


def _unused(log: RobotLog) -> Counter[str]:
    """Return the counts of a log without odometry, all of whose rows are left out."""
    return log.counts + Counter({
        'command': len(log.commands), 'observation': len(log.observations),
        'true pose': len(log.truth)})


def _checked(log: RobotLog, ordered: ClockPart) -> RobotLog:
    """Return a log of ordered rows, one command at each stamp and one observation of a subject."""
    commands, counts = ordered.commands, log.counts
    replaced = np.diff(commands.stamps, append=LAST_SECOND * NS) == 0
    commands = drop(commands, replaced, REPLACED_COMMAND, counts)
    return replace(
        log, commands=commands, observations=_once_in_scan(ordered.observations, counts),
        truth=without_slips(log.truth, commands, counts), clock_changes=ordered.clock_changes)


def _identified(
    observations: Series, robot: int, codes: Mapping[int, int], counts: Counter[str]
) -> Series:
    """Return observations with subjects instead of bar codes, without impossible ones."""
    # A new column: some codes are equal to another one's subject.
    codes_read, measured = observations.rows[:, 0], observations.rows[:, 1:]
    subjects = np.array([codes.get(code, -1) for code in codes_read.tolist()], dtype=float)
    kept = Series(observations.stamps, np.column_stack([subjects, measured]))
    kept = drop(kept, kept.rows[:, 0] < 0, UNKNOWN_CODE, counts)
    kept = drop(kept, kept.rows[:, 0] == robot, 'observation of itself', counts)
    r, bearing = kept.rows[:, 1], kept.rows[:, 2]
    impossible = (r <= 0.0) | (r > MAX_RANGE) | (np.abs(bearing) > 2.0 * math.pi)
    if impossible.sum() > max(len(kept) / 2, MAX_IMPOSSIBLE):
        raise UserError(
            f'Robot{robot}_Measurement.dat: {impossible.sum()} of {len(kept)} rows have an'
            ' impossible range or bearing: give time [s], bar code, range [m] and bearing [rad]')
    kept.rows[:, 2] = wrap_all(bearing)
    return drop(kept, impossible, 'impossible range or bearing', counts)


def _once_in_scan(observations: Series, counts: Counter[str]) -> Series:
    """Return the first observation of each subject at a stamp."""
    repeated = np.ones(len(observations), dtype=bool)
    keys = np.column_stack([observations.stamps, observations.rows[:, 0].astype(np.int64)])
    repeated[np.unique(keys, axis=0, return_index=True)[1]] = False
    return drop(observations, repeated, 'seen twice in one scan', counts)


def _series(path: Path, columns: int, counts: Counter[str]) -> Series:
    """Return a file of rows that begin with their time [s], as recorded; it may be missing."""
    broken: Counter[str] = Counter()
    rows = _table(path, columns, broken)
    counts['broken row'] += broken.total()
    return _stamped(rows, counts)


def _stamped(rows: Array, counts: Counter[str]) -> Series:
    """Return rows that begin with their time [s], in their order."""
    possible = (rows[:, 0] >= 0.0) & (rows[:, 0] < LAST_SECOND)
    counts['broken row'] += int((~possible).sum())
    rows = rows[possible]
    stamps: Stamps = np.rint(rows[:, 0] * TICKS).astype(np.int64) * (NS // TICKS)
    return Series(stamps, rows[:, 1:])


def _table(path: Path, columns: int, broken: Counter[str], *, max_columns: int = 0) -> Array:
    """
    Return the rows (n, columns) of a text file, and count the broken ones under its name.

    Columns beyond the first ones, up to `max_columns`, are ignored, and so is the heading of a
    CSV file; a missing file has no rows.
    """
    text = path.read_text(encoding='utf-8-sig', errors='replace') if path.is_file() else ''
    lines = (line.partition('#')[0] for line in text.splitlines())
    rows = [_numbers(line) for line in lines if line.strip()]
    whole = [row[:columns] for row in rows if columns <= len(row) <= max(columns, max_columns)]
    has_heading = path.suffix == '.csv' and bool(rows) and not rows[0]
    broken[path.name] += len(rows) - len(whole) - has_heading
    return np.array(whole).reshape(-1, columns)


def _of_subjects(rows: Array, path: Path, broken: Counter[str]) -> Array:
    """Return the rows that begin with a subject, and have no number beyond `MAX_ID`."""
    subjects, are_small = rows[:, 0], (np.abs(rows) <= MAX_ID).all(axis=1)
    valid: Array = rows[(subjects >= 0) & (subjects == subjects.round()) & are_small]
    broken[path.name] += len(rows) - len(valid)
    return valid


def _numbers(line: str) -> list[float]:
    """Return the numbers of a line, separated by spaces or commas; [] if not all are valid."""
    try:
        values = [float(word) for word in line.replace(',', ' ').split()]
    except ValueError:
        return []
    return values if all(map(math.isfinite, values)) else []
