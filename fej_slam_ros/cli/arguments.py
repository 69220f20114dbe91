# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the arguments of several verbs have in common."""

from argparse import ArgumentParser
from collections.abc import Callable, Mapping
import os
from pathlib import Path

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.files import bags


def add_bag_and_parameters(parser: ArgumentParser) -> None:
    """Add the bag to read, and under which parameters."""
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2')
    parser.add_argument(
        '--params', type=Path, required=True, metavar='FILE', help='ROS parameters (YAML)')


def add_storage(parser: ArgumentParser) -> None:
    """Add how a bag is to be written."""
    parser.add_argument(
        '--storage', choices=sorted(bags.STORAGES), default='mcap',
        help='format of the bag (default: %(default)s)')


def parameter_help(parameters: Mapping[str, Parameter]) -> str:
    """Return the help of parameters, by name, as text for the help of a verb."""
    return 'parameters:\n' + '\n'.join(f'  {name}: {p}' for name, p in parameters.items())


def at_least(least: int, option: str) -> Callable[[str], int]:
    """Return what reads the value of an option: a whole number that is not too small."""
    def number(word: str) -> int:
        if not word.isdecimal() or int(word) < least:
            raise UsageError(f'{option}: {word} is not a whole number from {least} on')
        return int(word)
    return number


def processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))
