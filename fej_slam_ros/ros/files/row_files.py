# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of tables and lines of text files, each converted by a function; errors name the row."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
import csv
from decimal import DecimalException
from pathlib import Path
from typing import TypeVar

from fej_slam_ros.errors import UserError
from fej_slam_ros.tables import Cells

SourceT = TypeVar('SourceT')
RowT = TypeVar('RowT')


class DamagedRowError(ValueError):
    """A row cannot be used; the message follows 'row 2 ...'."""


def read_table(
    path: Path, columns: Sequence[str], read: Callable[[Cells], RowT]
) -> Iterator[RowT]:
    """Yield the rows of a CSV file that has at least some columns."""
    with _reading(path), path.open(encoding='utf-8', newline='') as file:
        rows = csv.DictReader(file)
        missing = [name for name in columns if name not in (rows.fieldnames or ())]
        if missing:
            raise UserError(
                f'{path} lacks the column {missing[0]} of {",".join(columns)}: give a file that'
                ' this package wrote')
        yield from _parsed(path, rows, read, first=2)


def read_lines(path: Path, read: Callable[[str], RowT]) -> Iterator[RowT]:
    """Yield the content of each line of a file that is not empty and no comment."""
    with _reading(path), path.open(encoding='utf-8-sig') as file:
        lines = (line for line in file if line.strip() and not line.startswith('#'))
        yield from _parsed(path, lines, read, first=1)


def _parsed(
    path: Path, rows: Iterable[SourceT], read: Callable[[SourceT], RowT], first: int
) -> Iterator[RowT]:
    number = first
    try:
        for number, row in enumerate(rows, first):  # noqa: B007
            yield read(row)
    except (ValueError, TypeError, DecimalException, OverflowError) as error:
        cause = error if isinstance(error, DamagedRowError) else 'is damaged'
        raise UserError(
            f'{path}: row {number} {cause}, correct it or write the file again') from None


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UserError(f'{path} cannot be read, give another file: {error}') from None
