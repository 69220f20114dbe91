# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Text tables for the console, Markdown tables for reports, and the numbers in their cells."""

from collections.abc import Collection, Iterable, Mapping, Sequence
import math
import textwrap

#: Cells of a row of a CSV file by column; None where a row is too short.
Cells = Mapping[str, str | None]
#: Largest magnitude of a number in a cell, far beyond any unit: squares of products stay finite.
MAX_NUMBER = 1e60
#: Maximum width of a table [characters], and up to which a heading stays on one line beyond.
MAX_WIDTH, MIN_HEADING = 100, 7
#: Largest integer in an array
MAX_INTEGER = 2 ** 63 - 1


def text_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """
    Return an aligned table; the first column is left-aligned, the others right-aligned.

    The headings of one that would be too wide are several lines high.

    """
    body = [*rows]
    lines = [head, *body]
    widths = _widths(lines)
    if sum(widths) + 2 * (len(widths) - 1) > MAX_WIDTH:
        lines = [*_stacked(head, _widths([['' for _ in head], *body])), *body]
        widths = _widths(lines)
    return '\n'.join(
        '  '.join([first.ljust(widths[0]), *map(str.rjust, others, widths[1:])])
        for first, *others in lines)


def _widths(lines: Iterable[Sequence[str]]) -> list[int]:
    return [max(map(len, column)) for column in zip(*lines)]


def _stacked(head: Sequence[str], widths: Sequence[int]) -> Iterable[Sequence[str]]:
    """Return lines of headings about as narrow as the cells below them; words stay whole."""
    parts = [
        textwrap.wrap(title, max(width, MIN_HEADING), break_long_words=False)
        for title, width in zip(head, widths)]
    height = max(map(len, parts))
    return zip(*([''] * (height - len(part)) + part for part in parts))


def markdown_table(
    head: Sequence[str], rows: Iterable[Sequence[str]], text_columns: Collection[int] = (0,)
) -> str:
    """Return a Markdown table; columns that are not in `text_columns` are right-aligned."""
    rule = ['---' if column in text_columns else '--:' for column in range(len(head))]
    return '\n'.join(f'| {" | ".join(row)} |' for row in (head, rule, *rows))


def number(value: float | None, form: str) -> str:
    """Return a number in a format such as ``.3f``, or a dash for None."""
    return '-' if value is None else format(value, form)


def interval(bounds: Sequence[float]) -> str:
    """Return the lower and upper bound of an interval."""
    low, high = bounds
    return f'{low:.2f} to {high:.2f}'


def finite_numbers(cells: Cells, names: Sequence[str]) -> list[float]:
    """Return the numbers in some columns; raises ValueError for any other content."""
    return [_finite_number(name, cells[name]) for name in names]


def _finite_number(name: str, text: str | None) -> float:
    if text is None:
        raise ValueError(f'it ends before {name}')
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f'{name} is {text!r} and not a finite number')
    if abs(value) > MAX_NUMBER:
        raise ValueError(f'{name} is {text!r}, beyond {MAX_NUMBER:g}')
    return value


def integer(cells: Cells, name: str) -> int:
    """Return the integer in a column; raises ValueError for any other content."""
    text = cells[name]
    try:
        number = int(text or '')
    except ValueError:
        number = MAX_INTEGER + 1
    if abs(number) > MAX_INTEGER:
        raise ValueError(f'{name} is {text!r} and not an integer of 64 bits')
    return number
