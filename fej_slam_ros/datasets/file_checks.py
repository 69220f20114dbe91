# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of data set files, with errors that name the file and the cure."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import MAX_ID, NS
from fej_slam_ros.errors import UsageError, UserError

#: Messages hold seconds as int32.
LAST_SECOND = 2**31 - 1


def require_folder(folder: Path, content: str) -> None:
    """Raise a `UsageError` if a folder, which should hold the content, does not exist."""
    if not folder.is_dir():
        raise UsageError(f'no folder {folder}: give the one with {content}')


@contextmanager
def errors_name(path: Path) -> Iterator[None]:
    """Require a file, and name it in the message of any `UserError` raised in this context."""
    if not path.is_file():
        raise UserError(
            f'{path}: there is no such file; give the path where it is, or fetch it')
    try:
        yield
    except UserError as error:
        raise UserError(f'{path}: {error}; fetch the file again') from error


def checked_landmark_id(number: int, least: int = 0) -> int:
    """Return a landmark ID; raise a `ValueError` if no bag can have it."""
    if not least <= number <= MAX_ID:
        raise ValueError(f'id is {number} and not from {least} to {MAX_ID}')
    return number


def checked_stamp(stamp: int) -> int:
    """Return a stamp [ns]; raise a `ValueError` if no message can have it."""
    if not 0 <= stamp < LAST_SECOND * NS:
        raise ValueError(f'its time is {stamp} ns and not from 0 to {LAST_SECOND} s')
    return stamp


def require_finite(*columns: Array) -> None:
    """Raise a `UserError` if a value is not finite."""
    if not all(np.isfinite(column).all() for column in columns):
        raise UserError('a value is not finite')


def require_landmark_ids(scans: Array, ids: Array) -> None:
    """Raise a `UserError` for an ID that is no int32 >= 0, or that is twice in one scan."""
    if ((ids != np.floor(ids)) | (ids < 0) | (ids > MAX_ID)).any():
        raise UserError(f'a landmark has an id that is not an integer from 0 to {MAX_ID}')
    if len(np.unique(np.column_stack([scans, ids]), axis=0)) < len(ids):
        raise UserError('a scan observes one landmark twice')
