# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parser of arguments that suggests the nearest name, and help that fits the terminal."""

from argparse import Action, ArgumentError, ArgumentParser, HelpFormatter, Namespace
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from itertools import takewhile
import re
import textwrap
from typing import Any

#: What separates the columns of a table, or indents its lines.
COLUMNS = re.compile(r'^ +|(?<=\S)  +')


class Parser(ArgumentParser):
    """Parser that suggests the nearest name for one that does not exist."""

    def parse_known_args(  # type: ignore[override]  # the overloads are for other namespaces
        self, args: Sequence[str], namespace: Namespace | None = None,
    ) -> tuple[Namespace, list[str]]:
        """Parse arguments, after a check for misspelt options of this parser."""
        # What follows the name of a further parser is checked by that one.
        own = takewhile(lambda word: word.startswith('-'), args) if self._subparsers else args
        for option in takewhile(lambda word: word != '--', own):
            self._check_option(option.partition('=')[0])
        return super().parse_known_args(args, namespace)

    def _check_option(self, option: str) -> None:
        known = self._option_string_actions
        if option.startswith('--') and option not in known and (
                alike := _nearest(option, known)):
            self.error(f'there is no option {option}, did you mean {alike}?')

    def _check_value(self, action: Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            choices = [*map(str, action.choices)]
            alike = _nearest(str(value), choices)
            raise ArgumentError(action, f'there is no {value}, ' + (
                f'did you mean {alike}?' if alike else f'choose from {", ".join(choices)}'))


class Formatter(HelpFormatter):
    """Formatter that fills paragraphs and wraps the lines of tables, which have columns."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return '\n\n'.join(
            _wrapped(paragraph.splitlines(), width) for paragraph in text.split('\n\n'))


def _nearest(name: str, names: Iterable[str]) -> str:
    return next(iter(get_close_matches(name, names, 1)), '')


def _wrapped(lines: Sequence[str], width: int) -> str:
    if not any(map(COLUMNS.search, lines)):
        return textwrap.fill(' '.join(lines), width, break_on_hyphens=False)
    return '\n'.join(
        textwrap.fill(
            line, width, subsequent_indent=_hanging_indent(line), break_on_hyphens=False)
        for line in lines)


def _hanging_indent(line: str) -> str:
    """Return the indent of the text in the second column of a line."""
    columns = [*COLUMNS.finditer(line)]
    return ' ' * columns[-1].end() if columns else ''
