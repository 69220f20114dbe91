# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Writers of text, CSV, JSON and figures: a file appears complete or not at all.

They raise UserError, with the path and the reason, if a file cannot be written.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
import csv
from io import BytesIO
import json
import os
from pathlib import Path
from typing import Any, TextIO

from fej_slam_ros.errors import UsageError, UserError


def refuse_existing(paths: Iterable[Path], force: bool | None) -> None:
    """Raise UsageError if a file or folder exists, unless forced; None: there is no --force."""
    for path in paths:
        if path.exists() and not force:
            other = ', or remove it' if force is None else ', or --force to replace it'
            raise UsageError(f'{path} exists: choose another path{other}')


def make_folder(path: Path) -> None:
    """Create a folder and its parents if they do not exist."""
    with _writing(f'to {path}'):
        path.mkdir(parents=True, exist_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write or replace a text file."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write or replace a file."""
    with PartFile(path) as part:
        with _writing(path):
            part.file.buffer.write(content)
        part.keep()


def write_csv(path: Path, rows: Iterable[Sequence[object]]) -> None:
    """Write or replace a CSV file of rows of cells."""
    with PartFile(path) as part:
        csv.writer(part.file, lineterminator='\n').writerows(rows)
        part.keep()


def write_json(path: Path, content: Any) -> None:
    """Write or replace a JSON file."""
    write_text(path, json.dumps(content, indent=2) + '\n')


def write_figure(path: Path, draw: Callable[..., None], *content: Any) -> None:
    """Write or replace a picture, drawn by a function of a binary file and the content."""
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
        with _writing(path):
            self.file: TextIO = self._part.open('w+', encoding='utf-8', newline='\n')

    def __enter__(self) -> 'PartFile':
        return self

    def __exit__(self, *_: object) -> None:
        self.file.close()
        self._part.unlink(missing_ok=True)

    def keep(self) -> None:
        """Sync the file to disk, then rename it: a crash leaves the old file or the new one."""
        with _writing(self._path):
            self.file.flush()
            os.fsync(self.file.fileno())
            self.file.close()
            self._part.replace(self._path)


@contextmanager
def _writing(what: object) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UserError(f'cannot write {what}: {error.strerror}') from None
