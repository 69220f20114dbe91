# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks that are known before a run: a survey, or the map or checkpoint of an earlier run."""

from collections.abc import Mapping
import csv
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID, PriorMap
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.messages.incoming import MAX_COORDINATE, MAX_ID, MAX_VARIANCE, MIN_VARIANCE

COLUMNS = ('id', 'x', 'y', 'var_x', 'cov_xy', 'var_y')


def prior_map(name: str) -> PriorMap | None:
    """
    Return the landmarks in the file of that name, None for ''.

    Of a table, rows of other frames than ``map`` are left out; its landmarks are independent. A
    checkpoint tells how the errors of its landmarks belong together.

    Raises
    ------
    UserError
        The file cannot be read, or something in it is not what it must be.

    """
    path = Path(name)
    if not name:
        return None
    try:
        if checkpoint.is_checkpoint(path):
            return checkpoint.load_map(path)
        with path.open(encoding='utf-8-sig', errors='replace', newline='') as file:
            return _read(csv.DictReader(file))
    except OSError as error:
        raise UserError(f'cannot read the prior landmarks {path}: {error.strerror}') from None
    except (ValueError, csv.Error) as error:
        raise UserError(f'{path} cannot be read as a table of landmarks: {error}') from None


def _read(rows: 'csv.DictReader[str]') -> PriorMap:
    for name in COLUMNS:
        if name not in (rows.fieldnames or ()):
            raise ValueError(f'it lacks the column {name} of {",".join(COLUMNS)}')
    lines: dict[int, int] = {}
    points, blocks = [], []
    for row in rows:
        if row.get('frame', MAP) != MAP:
            continue
        try:
            number, point, P = _landmark(row)
        except ValueError as error:
            raise ValueError(f'correct line {rows.line_num}, {error}') from None
        if number in lines:
            raise ValueError(
                f'id {number} is in line {lines[number]} and in line {rows.line_num}, keep one')
        lines[number] = rows.line_num
        points.append(point)
        blocks.append(P)
    if not lines:
        raise ValueError(f'it has no landmark in the frame {MAP}')
    return PriorMap(tuple(lines), np.array(points), block_diag(*blocks))


def _landmark(row: Mapping[str, str | None]) -> tuple[int, Array, Array]:
    number = row['id'] or ''
    if not _is_landmark(number):
        raise ValueError(
            f'where id is {number!r} and not an integer up to {MAX_ID} other than {NO_ID}')
    x, y, var_x, cov_xy, var_y = (_number(name, row[name]) for name in COLUMNS[1:])
    P = np.array([[var_x, cov_xy], [cov_xy, var_y]])
    if max(abs(x), abs(y)) > MAX_COORDINATE or np.abs(P).max() > MAX_VARIANCE:
        raise ValueError(f'which goes beyond {MAX_COORDINATE:g} m or {MAX_VARIANCE:g} m^2')
    if np.linalg.eigvalsh(P)[0] < MIN_VARIANCE:
        raise ValueError('where the covariance is not positive definite')
    return int(number), np.array([x, y]), P


def _is_landmark(number: str) -> bool:
    """Return whether a text is a number of a landmark; below `NO_ID` are those without any."""
    digits = number.removeprefix('-')
    return (
        digits.isascii() and digits.isdigit() and abs(int(number)) <= MAX_ID
        and int(number) != NO_ID)


def _number(name: str, text: str | None) -> float:
    try:
        value = float(text or '')
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise ValueError(f'where {name} is {text!r} and not a finite number')
    return value
