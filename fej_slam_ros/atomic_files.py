# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Writers of text, CSV, JSON and figures: a file appears complete or not at all."""

from collections.abc import Callable, Iterable, Sequence
import csv
from io import BytesIO
import json
import os
from pathlib import Path
from typing import Any, TextIO

from fej_slam_ros.errors import UsageError, UserError


def refuse_existing(paths: Iterable[Path], force: bool) -> None:
    """
    Raise if a file or folder exists, unless it may be replaced.

    Raises
    ------
    UsageError
        One of the paths exists and force is False.

    """
    for path in paths:
        if path.exists() and not force:
            raise UsageError(f'{path} exists: choose another path, or --force to replace it')


def make_folder(path: Path) -> None:
    """
    Create a folder and its parents if they do not exist.

    Raises
    ------
    UserError
        It cannot be created.

    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f'cannot write to {path}: {error.strerror}') from None


def write_text(path: Path, text: str) -> None:
    """
    Write or replace a text file atomically.

    Raises
    ------
    UserError
        The file cannot be written.

    """
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """
    Write or replace a file atomically.

    Raises
    ------
    UserError
        The file cannot be written.

    """
    try:
        with PartFile(path) as part:
            part.file.buffer.write(content)
            part.keep()
    except OSError as error:
        raise UserError(f'cannot write {path}: {error.strerror}') from None


def write_csv(path: Path, rows: Iterable[Sequence[object]]) -> None:
    """
    Write or replace a CSV file of rows of cells atomically.

    Raises
    ------
    UserError
        The file cannot be written.

    """
    with PartFile(path) as part:
        csv.writer(part.file, lineterminator='\n').writerows(rows)
        part.keep()


def write_json(path: Path, content: Any) -> None:
    """
    Write or replace a JSON file atomically.

    Raises
    ------
    UserError
        The file cannot be written.

    """
    write_text(path, json.dumps(content, indent=2) + '\n')


def write_figure(path: Path, draw: Callable[..., None], *content: Any) -> None:
    """
    Write or replace a picture atomically.

    Parameters
    ----------
    path : of the picture
    draw : called with a binary file to write to, and with the content

    """
    picture = BytesIO()
    draw(picture, *content)
    write_bytes(path, picture.getvalue())


class PartFile:
    """
    A text file that gets its name when it is complete; until then it is ``NAME.part``.

    Leaving the context without `keep` discards it.

    Attributes
    ----------
    file : the open file

    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._part = path.with_name(f'{path.name}.part')
        make_folder(path.parent)
        try:
            self.file: TextIO = self._part.open('w+', encoding='utf-8', newline='\n')
        except OSError as error:
            raise UserError(f'cannot write {path}: {error.strerror}') from None

    def __enter__(self) -> 'PartFile':
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()
        self._part.unlink(missing_ok=True)

    def keep(self) -> None:
        """Sync the file to disk, then rename it: a crash leaves the old file or the new one."""
        try:
            self.file.flush()
            os.fsync(self.file.fileno())
            self.file.close()
            self._part.replace(self._path)
        except OSError as error:
            raise UserError(f'cannot write {self._path}: {error.strerror}') from None
