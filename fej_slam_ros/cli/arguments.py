# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Command-line arguments that several verbs share."""

from argparse import Action, ArgumentParser, Namespace, SUPPRESS
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
import logging
import math
import os
from pathlib import Path
from shutil import get_terminal_size
import textwrap

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.files import bags


class OldFlag(Action):
    """Old name of an option that sets `dest` to False: it does so with a warning."""

    def __init__(self, option_strings: Sequence[str], dest: str, present: str) -> None:
        super().__init__(option_strings, dest, nargs=0, default=True, help=SUPPRESS)
        self._present = present

    def __call__(
        self, parser: ArgumentParser, namespace: Namespace, values: object,
        option_string: str | None = None,
    ) -> None:
        logging.getLogger(__name__).warning(
            'option %s is deprecated: write %s', option_string, self._present)
        setattr(namespace, self.dest, False)


def add_bag_and_parameters(parser: ArgumentParser) -> None:
    """Add the input bag and the parameter file."""
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2')
    parser.add_argument(
        '--params', type=Path, required=True, metavar='FILE',
        help='ROS parameters (YAML), at least the list robots')


def add_output_bag(
    parser: ArgumentParser, what: str, replaced: str = 'an existing bag', required: bool = True
) -> None:
    """Add the output bag, its storage format, and the option to replace an earlier one."""
    parser.add_argument('--output', type=Path, required=required, metavar='BAG', help=what)
    parser.add_argument(
        '--storage', choices=sorted(bags.STORAGES), default='mcap',
        help='format of the bag (default: %(default)s)')
    parser.add_argument('--force', action='store_true', help=f'replace {replaced}')


def output_folder(word: str) -> Path:
    """Return the folder of the option --output; an empty word is that of an unset variable."""
    if not word:
        raise UsageError('--output is empty: give a folder, or . for the current one')
    return Path(word)


def refuse_input_as_output(output: Path, bag: Path) -> None:
    """Raise UsageError if an output, such as a bag or a folder, is the bag that is read."""
    if output.resolve() == bag.resolve():
        raise UsageError(f'{output} is the bag to read: choose another output')


def require_matplotlib(alternative: str = '') -> None:
    """Raise UserError if figures cannot be drawn, with the option by which none are."""
    if find_spec('matplotlib') is None:
        other = f', or {alternative}' if alternative else ''
        raise UserError(f"matplotlib is missing: pip install -e '.[plot]' in the clone{other}")


def parameter_help(parameters: Mapping[str, Parameter]) -> str:
    """Return the help of ROS parameters, with what each must be, for the help of a verb."""
    # The width of argparse.
    width = get_terminal_size().columns - 2
    return '\n'.join(['parameters:', *(
        textwrap.fill(
            f'{name}: {p}; must be {p.kind.expected}', width, initial_indent='  ',
            subsequent_indent='    ', break_long_words=False, break_on_hyphens=False)
        for name, p in parameters.items())])


def integer_option(option: str, least: int, most: float = math.inf) -> Callable[[str], int]:
    """Return a parser of an option's value, an integer in a range."""
    def parse(word: str) -> int:
        if not word.isdecimal() or not least <= int(word) <= most:
            bounds = f'of at least {least}' if most == math.inf else f'from {least} to {most:g}'
            raise UsageError(f'{option}: {word} is not an integer {bounds}')
        return int(word)
    return parse


def number_option(option: str, least: float, most: float = 1e6) -> Callable[[str], float]:
    """Return a parser of an option's value, a number in a range."""
    def parse(word: str) -> float:
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise UsageError(f'{option}: {word} is not a number from {least:g} to {most:g}')
        return value
    return parse


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0))
