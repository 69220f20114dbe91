# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Prior maps: landmarks known before a run, from a survey, a map file or a checkpoint."""

import csv
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import MAX_ID, NO_ID, PriorMap
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.files.csv_rows import LandmarkRow, read_landmark, SURVEY_COLUMNS
from fej_slam_ros.ros.messages.incoming import MAX_COORDINATE, MAX_VARIANCE, MIN_VARIANCE
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.tables import Cells

#: Lowest ID in a map. A run without IDs assigns those below the lowest, and IDs are published as
#: int32.
MIN_MAP_ID = -2**30


def prior_map(settings: RunSettings) -> PriorMap | None:
    """
    Return the landmarks that the settings name, None if they name none.

    Rows of a CSV file in other frames than ``map`` are ignored, and its landmarks are independent.
    A checkpoint provides the joint covariance of its landmarks.

    """
    path, most = Path(settings.node.prior_landmarks), settings.estimation.max_landmarks
    if not settings.node.prior_landmarks:
        return None
    try:
        if checkpoint.is_checkpoint(path):
            prior = checkpoint.load_map(path)
            _check_number(len(prior.ids), most)
            return prior
        if _has_ids_of_each_robot(path):
            raise checkpoint.no_shared_ids(path)
        with path.open(encoding='utf-8-sig', errors='replace', newline='') as file:
            return _read(csv.DictReader(file), most)
    except OSError as error:
        raise UserError(
            f'cannot read the prior landmarks {path}: {error.strerror}; give the path of a table,'
            ' or of landmarks.csv or the checkpoint of an earlier run') from None
    except (ValueError, csv.Error) as error:
        raise UserError(f'{path} cannot be read as a table of landmarks: {error}') from None


def _has_ids_of_each_robot(path: Path) -> bool:
    """Return whether a map is of a run in which a landmark has an ID of each robot's own."""
    ids = path.with_name('ids.csv')
    return path.name == 'landmarks.csv' and ids.exists() and bool(
        ids.read_text(encoding='utf-8', errors='replace').splitlines()[1:])


def _check_number(landmarks: int, most: int) -> None:
    # Their covariance is dense once robots have observed them.
    if landmarks > most:
        raise ValueError(
            f"it has more than {most:,} landmarks in {MAP}, the value of 'max_landmarks': leave"
            ' out those that no robot observes, or raise it, n landmarks take 32 n^2 bytes')


def _read(rows: 'csv.DictReader[str]', most: int) -> PriorMap:
    for column in SURVEY_COLUMNS:
        if column not in (rows.fieldnames or ()):
            raise ValueError(f'it lacks the column {column} of {",".join(SURVEY_COLUMNS)}')
    lines: dict[int, int] = {}
    landmarks = []
    for cells in rows:
        frame = cells.get('frame', MAP)
        if frame not in (MAP, None):
            continue
        try:
            if frame is None:
                raise ValueError('it ends before frame')
            landmark = _landmark(cells)
        except ValueError as error:
            raise ValueError(f'correct line {rows.line_num}: {error}') from None
        if landmark.id in lines:
            raise ValueError(
                f'id {landmark.id} is in line {lines[landmark.id]} and in line {rows.line_num},'
                ' keep one')
        lines[landmark.id] = rows.line_num
        _check_number(len(lines), most)
        landmarks.append(landmark)
    if not lines:
        raise ValueError(f'it has no landmark in the frame {MAP}')
    return PriorMap(
        tuple(lines), np.array([landmark.point for landmark in landmarks]),
        block_diag(*(landmark.P for landmark in landmarks)))


def _landmark(cells: Cells) -> LandmarkRow:
    text = cells['id'] or ''
    if not _is_landmark_id(text):
        raise ValueError(
            f'id is {text!r} and not an integer from {MIN_MAP_ID} to {MAX_ID} other than'
            f' {NO_ID}')
    landmark = read_landmark(cells)
    if np.abs(landmark.point).max() > MAX_COORDINATE or np.abs(landmark.P).max() > MAX_VARIANCE:
        raise ValueError(f'it exceeds {MAX_COORDINATE:g} m or {MAX_VARIANCE:g} m^2')
    if np.linalg.eigvalsh(landmark.P)[0] < MIN_VARIANCE:
        raise ValueError('the covariance is not positive definite')
    return landmark


def _is_landmark_id(text: str) -> bool:
    digits = text.removeprefix('-')
    return digits.isascii() and digits.isdigit() and (
        MIN_MAP_ID <= int(text) <= MAX_ID and int(text) != NO_ID)
