# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Files appear whole or not at all, and nothing is overwritten unasked."""

from collections.abc import Iterable, Sequence
import csv
import json
import os
from pathlib import Path
from typing import Any, TextIO

from fej_slam_ros.errors import UsageError, UserError


def refuse_existing(paths: Iterable[Path], force: bool) -> None:
    """
    Refuse to go on where a file or folder is there already, unless it may be replaced.

    Raises
    ------
    UsageError
        One of the paths exists and force is False.

    """
    for path in paths:
        if path.exists() and not force:
            raise UsageError(f'{path} exists: choose another place, or --force to replace it')


def make_folder(path: Path) -> None:
    """
    Make a folder if it is not there.

    Raises
    ------
    UserError
        It cannot be made.

    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f'cannot write to {path}: {error.strerror}') from None


def write_text(path: Path, text: str) -> None:
    """
    Write a text file, or replace one, in one go.

    Raises
    ------
    UserError
        The file cannot be written.

    """
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """
    Write a file, or replace one, in one go.

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
    Write rows of cells, or replace them, in one go.

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
    Write what JSON knows as a file, or replace one, in one go.

    Raises
    ------
    UserError
        The file cannot be written.

    """
    write_text(path, json.dumps(content, indent=2) + '\n')


class PartFile:
    """
    A text file that has its name only when it is complete; until then it is ``NAME.part``.

    Leaving it as a context discards what was not kept.

    Attributes
    ----------
    file : to write to

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
        """Give the file its name, once it is on the disk: a crash leaves the old one or this."""
        try:
            self.file.flush()
            os.fsync(self.file.fileno())
            self.file.close()
            self._part.replace(self._path)
        except OSError as error:
            raise UserError(f'cannot write {self._path}: {error.strerror}') from None
