# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Records in a folder of CSV tables, one row for each message or observation; docs/data.md has them.

Numbers are written so that they are read back to the same bits.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
import csv
from decimal import Decimal, DecimalException
from itertools import groupby
import math
from operator import attrgetter
from pathlib import Path
from typing import TypeVar

import numpy as np

from fej_slam_ros.core.definiteness import is_definite, is_semidefinite
from fej_slam_ros.core.geometry import Array, compose, motion_to_begin, symmetric
from fej_slam_ros.core.ground_truth import MAX_GAP
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.core.parameter_kinds import ROBOT_NAMES
from fej_slam_ros.core.records import (
    NO_ID, NS, Observation, ObservationT, Odometry, PosePrior, Record, RobotObservation, RobotScan,
    Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import numbered_robots, ORIGIN, Settings, Triple
from fej_slam_ros.datasets.csv_stamps import require_one_clock, require_one_clock_of_scans
from fej_slam_ros.datasets.file_checks import (
    checked_landmark_id, checked_stamp, LAST_SECOND, require_folder)
from fej_slam_ros.datasets.scans import Content, content, distinct, divided
from fej_slam_ros.errors import UserError
from fej_slam_ros.tables import Cells, finite_numbers, integer

EVENT_COLUMNS = ('robot', 'stamp_ns')
POSE = ('x', 'y', 'yaw')
#: Upper triangle of the covariance of the velocity.
TWIST = ('cov_vxvx', 'cov_vxvy', 'cov_vxwz', 'cov_vyvy', 'cov_vywz', 'cov_wzwz')
#: Upper triangle of the covariance of a pose.
POSE_COVARIANCE = ('cov_xx', 'cov_xy', 'cov_xyaw', 'cov_yy', 'cov_yyaw', 'cov_yawyaw')
POINT = ('x', 'y', 'var_x', 'cov_xy', 'var_y')
POLAR = ('range', 'bearing', 'sigma_range', 'sigma_bearing')
#: Columns of the tables, as they are written.
COLUMNS = {
    'odometry.csv': (*EVENT_COLUMNS, *POSE, *TWIST),
    'landmarks.csv': (*EVENT_COLUMNS, 'id', *POINT),
    'robots.csv': (*EVENT_COLUMNS, 'observed', *POINT),
    'pose_priors.csv': (*EVENT_COLUMNS, *POSE, *POSE_COVARIANCE),
    'ground_truth.csv': (*EVENT_COLUMNS, *POSE),
    'ground_truth_landmarks.csv': ('id', 'x', 'y'),
}

#: Robot and stamp [ns].
Event = tuple[str, int]
RowT = TypeVar('RowT')


def tables(records: Iterable[Record]) -> dict[str, list[Sequence[object]]]:
    """Return the rows of the tables that the records need, headings first, by file name."""
    rows: dict[str, list[Sequence[object]]] = defaultdict(list)
    for record in records:
        if isinstance(record, TrueLandmarks):
            rows['ground_truth_landmarks.csv'] += (
                (id_, *point.tolist()) for id_, point in record.positions.items())
            continue
        event = record.robot, record.stamp
        if isinstance(record, Odometry):
            rows['odometry.csv'].append((
                *event, *record.pose.tolist(), *_upper(record.twist_covariance, 3)))
        elif isinstance(record, Scan):
            rows['landmarks.csv'] += _scan_rows(event, [
                (o.id, *o.z.tolist(), *_upper(o.R, 2)) for o in record.observations])
        elif isinstance(record, RobotScan):
            rows['robots.csv'] += _scan_rows(event, [
                (o.observed, *o.z.tolist(), *_upper(o.R, 2)) for o in record.observations])
        elif isinstance(record, PosePrior):
            rows['pose_priors.csv'].append((*event, *record.pose.tolist(), *_upper(record.P, 3)))
        else:
            rows['ground_truth.csv'].append((*event, *record.pose.tolist()))
    return {name: [COLUMNS[name], *rows[name]] for name in COLUMNS if name in rows}


def read(folder: Path, repeated: Counter[str]) -> list[Record]:
    """
    Return the records in a folder in the order of stamps, the true landmarks first.

    Observations that repeat another one of their stamp are left out, and counted by the table. A
    UserError says that there is no odometry, or that a row is damaged.

    """
    require_folder(folder, 'odometry.csv')
    odometry = [*_rows(folder / 'odometry.csv', _odometry)]
    if not odometry:
        raise UserError(
            f'{folder / "odometry.csv"} is missing or has no row: it needs the columns'
            f' {",".join((*EVENT_COLUMNS, *POSE))}')
    require_one_clock(folder / 'odometry.csv', odometry)
    scans = [
        Scan(*event, seen)
        for event, seen in _scans(folder / 'landmarks.csv', _landmark, repeated)]
    robot_scans = [
        RobotScan(*event, seen)
        for event, seen in _scans(folder / 'robots.csv', _robot, repeated)]
    require_one_clock_of_scans(folder / 'landmarks.csv', scans)
    require_one_clock_of_scans(folder / 'robots.csv', robot_scans)
    records: list[Record] = [*odometry, *scans, *robot_scans]
    records += _rows(folder / 'pose_priors.csv', _pose_prior)
    _require_odometry(folder, records)
    records += _rows(folder / 'ground_truth.csv', _true_pose)
    records.sort(key=attrgetter('stamp'))
    landmarks = _true_landmarks(folder / 'ground_truth_landmarks.csv')
    return [*([TrueLandmarks(landmarks, records[0].stamp)] if landmarks else []), *records]


def _true_landmarks(path: Path) -> dict[int, Array]:
    """Return the true positions (2,) of landmarks by ID."""
    landmarks: dict[int, Array] = {}
    for id_, point in _rows(path, _true_landmark):
        if not np.array_equal(landmarks.setdefault(id_, point), point):
            raise UserError(f'{path} has several positions of landmark {id_}: keep one')
    return landmarks


def settings(records: Iterable[Record]) -> Settings:
    """
    Return the default settings of a team: the robots with odometry, the first as anchor.

    The anchor starts at its true pose if that is known, else at the origin.

    """
    of_robots: dict[str, list[Odometry]] = defaultdict(list)
    true_poses: dict[str, list[TruePose]] = defaultdict(list)
    for record in records:
        if isinstance(record, Odometry):
            of_robots[record.robot].append(record)
        elif isinstance(record, TruePose):
            true_poses[record.robot].append(record)
    anchor, *_ = names = sorted(of_robots)
    start = _true_start(of_robots[anchor], true_poses[anchor])
    return Settings(numbered_robots(names), anchor=anchor, anchor_pose=start or ORIGIN)


def _true_start(odometry: Sequence[Odometry], true_poses: Iterable[TruePose]) -> Triple | None:
    """
    Return a robot's true pose at its first odometry, None if it is not known.

    Odometry leads back from the first true pose since then, at most `MAX_GAP` later.

    """
    begin = odometry[0].stamp
    first = next((true for true in true_poses if true.stamp >= begin), None)
    if first is None or first.stamp > begin + MAX_GAP:
        return None
    back = motion_to_begin(
        first.stamp, np.array([record.stamp for record in odometry]),
        np.array([record.pose for record in odometry]))
    x, y, phi = compose(first.pose, back).tolist()
    return x, y, phi


def _require_odometry(folder: Path, records: Iterable[Record]) -> None:
    """Raise a `UserError` if a robot observes, or is observed, without odometry."""
    robots, known = set(), set()
    for record in records:
        if isinstance(record, Odometry):
            known.add(record.robot)
        elif not isinstance(record, TrueLandmarks):
            robots.add(record.robot)
        if isinstance(record, RobotScan):
            robots |= {observation.observed for observation in record.observations}
    if robots - known:
        names = ', '.join(sorted(robots - known))
        raise UserError(
            f'{folder} has observations by or of {names}, without odometry: add rows to'
            ' odometry.csv, or remove the observations')


def _scan_rows(
    event: Event, rows: list[tuple[object, ...]]
) -> Iterator[Sequence[object]]:
    """Yield a row for each observation; a scan without any is a row without one."""
    yield from ((*event, *row) for row in rows or [('',) * (1 + len(POINT))])


def _upper(P: Array | None, size: int) -> list[object]:
    rows, columns = np.triu_indices(size)
    return [''] * len(rows) if P is None else P[rows, columns].tolist()


def _rows(path: Path, parse: Callable[[Cells], RowT]) -> Iterator[RowT]:
    """Yield the rows of a table; a missing file has none."""
    if not path.exists() and not path.is_symlink():
        return
    if not path.is_file() or not path.stat().st_size:
        raise UserError(f'{path} is no file, or empty: write a table with headings, or remove it')
    with path.open(encoding='utf-8-sig', errors='replace', newline='') as file:
        reader = csv.DictReader(file)
        try:
            for name, count in Counter(reader.fieldnames).items():
                if count > 1 and name.isidentifier():
                    raise ValueError(f'it has the column {name!r} twice')
            for cells in reader:
                _require_whole(cells, reader.fieldnames or ())
                yield parse(cells)
        except KeyError as column:
            raise UserError(
                f'{path}: correct its first line, which lacks the column {column}, separated by'
                f' commas: {",".join(reader.fieldnames or ())[:80]!r}') from None
        except (ValueError, csv.Error, UserError) as error:
            raise UserError(f'{path}: correct line {reader.line_num}: {error}') from None


def _require_whole(cells: dict[str | None, str | None], columns: Sequence[str]) -> None:
    """
    Raise a `ValueError` if a row has not as many cells as the first line.

    A row that ends after its stamp is a scan without observations.

    """
    # A cell of the first line may be lacking, too, which is for the parser to name.
    if any(cells.pop(None, None) or ()) and {*columns} & {'robot', 'id'}:
        raise ValueError(
            'it has more cells than the first line; decimals are written with a point')
    missing = [name for name in columns if cells[name] is None]
    if missing and {*columns} - {*missing} not in ({'robot', 'stamp_ns'}, {'robot', 'time'}):
        raise ValueError(f'it ends before {missing[0]}; cells without a value are empty')


def _event(cells: Cells) -> Event:
    robot = _robot_name(cells, 'robot')
    if 'time' in cells and 'stamp_ns' not in cells:
        return robot, checked_stamp(_from_seconds(cells['time'] or ''))
    return robot, checked_stamp(integer(cells, 'stamp_ns'))


def _robot_name(cells: Cells, column: str) -> str:
    """Return the name of a robot, which is part of those of topics in ROS."""
    name = cells[column] or ''
    if not name:
        raise ValueError(f'{column} is empty')
    if ROBOT_NAMES.read([name]) is None:
        raise ValueError(
            f'{column} is {name!r}, and a name begins with a letter and goes on with letters,'
            ' digits and _')
    return name


def _from_seconds(text: str) -> int:
    """Return a time of any number of digits in nanoseconds."""
    with suppress(DecimalException):
        seconds = Decimal(text)
        if abs(seconds) <= LAST_SECOND:
            return round(seconds * NS)
    raise ValueError(f'time is {text!r} and not a number of seconds up to {LAST_SECOND}')


def _odometry(cells: Cells) -> Odometry:
    covariance = _covariance(cells, TWIST, is_semidefinite) if _has(cells, TWIST) else None
    return Odometry(*_event(cells), np.array(finite_numbers(cells, POSE)), covariance)


def _landmark(cells: Cells) -> tuple[Event, Observation | None]:
    if _is_empty(cells, 'id'):
        return _event(cells), None
    landmark = _id(cells) if cells['id'] else NO_ID
    return _event(cells), Observation(checked_landmark_id(landmark, NO_ID), *_point(cells))


def _id(cells: Cells) -> int:
    """Return the ID in a row; pandas writes 4 as 4.0 if another row has none."""
    return integer({**cells, 'id': (cells['id'] or '').removesuffix('.0')}, 'id')


def _robot(cells: Cells) -> tuple[Event, RobotObservation | None]:
    if _is_empty(cells, 'observed'):
        return _event(cells), None
    return _event(cells), RobotObservation(_robot_name(cells, 'observed'), *_point(cells))


def _is_empty(cells: Cells, name: str) -> bool:
    """Return whether a row is that of a scan without observations; raise a KeyError without it."""
    return not cells[name] and not _has(cells, (*POINT, *POLAR))


def _has(cells: Cells, names: Iterable[str]) -> bool:
    return any(cells.get(name) for name in names)


def _pose_prior(cells: Cells) -> PosePrior:
    return PosePrior(
        *_event(cells), np.array(finite_numbers(cells, POSE)),
        _covariance(cells, POSE_COVARIANCE, is_definite))


def _true_pose(cells: Cells) -> TruePose:
    return TruePose(*_event(cells), np.array(finite_numbers(cells, POSE)))


def _true_landmark(cells: Cells) -> tuple[int, Array]:
    return (
        checked_landmark_id(_id(cells)), np.array(finite_numbers(cells, POINT[:2])))


def _point(cells: Cells) -> tuple[Array, Array]:
    """Return an observed position and covariance, zeros if unknown, as in scans."""
    if 'range' in cells and 'x' not in cells:
        distance, bearing, *sigmas = finite_numbers(cells, POLAR)
        if abs(bearing) > 2.0 * math.pi:
            raise ValueError(f'bearing is {bearing:g} rad, more than a turn: is it in degrees?')
        return polar(distance, bearing, *sigmas)
    z = np.array(finite_numbers(cells, POINT[:2]))
    if not _has(cells, POINT[2:]):
        return z, np.zeros((2, 2))
    return z, _covariance(cells, POINT[2:], _is_definite_or_unknown)


def _covariance(
    cells: Cells, names: Sequence[str], is_valid: Callable[[Array], bool]
) -> Array:
    """Return the covariance whose upper triangle is in some columns."""
    P = symmetric(finite_numbers(cells, names))
    if not is_valid(P):
        raise ValueError(
            f'{", ".join(names)} are no covariance: variances must be positive, and'
            ' correlations below 1')
    return P


def _is_definite_or_unknown(R: Array) -> bool:
    """Return whether the covariance of an observation is valid; zeros are unknown, as in scans."""
    return not R.any() or is_definite(R)


def _scans(
    path: Path, parse: Callable[[Cells], tuple[Event, ObservationT | None]],
    repeated: Counter[str],
) -> Iterator[tuple[Event, tuple[ObservationT, ...]]]:
    """Yield the scans in consecutive rows of one robot and stamp, which repeat no earlier row."""
    used: defaultdict[Event, set[Content]] = defaultdict(set)
    for event, of_event in groupby(_rows(path, parse), lambda row: row[0]):
        seen = [observation for _, observation in of_event if observation is not None]
        kept = [s for s in distinct(seen) if content(s) not in used[event]]
        used[event].update(map(content, kept))
        repeated[path.name] += len(seen) - len(kept)
        for scan in divided(kept) if kept or not seen else ():
            yield event, scan
