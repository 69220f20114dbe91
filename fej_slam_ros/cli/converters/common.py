# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arguments and output that all converters share."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterable
from pathlib import Path

from fej_slam_ros.atomic_files import write_text
from fej_slam_ros.cli.arguments import add_output_bag
from fej_slam_ros.core.records import GpsFix, Record
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.output_lock import claimed
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags


def add_paths(
    parser: ArgumentParser, output_required: bool = True, metavar: str = 'DIR',
    source: str = 'folder of the data set',
) -> None:
    """Add the data set, which is a folder by default, and the output bag."""
    parser.add_argument('--input', metavar=metavar, type=Path, required=True, help=source)
    add_output(parser, output_required)


def add_output(parser: ArgumentParser, required: bool = True) -> None:
    """Add the output bag."""
    add_output_bag(parser, 'folder of the bag', 'an existing bag and its parameters', required)


def write(
    records: Iterable[Record | GpsFix], settings: Settings, arguments: Namespace,
    report: Iterable[str],
) -> None:
    """Write the bag and its parameters, then print a report, which is evaluated last."""
    ids = {robot.name: robot.id for robot in settings.robots}
    write_with_parameters(
        lambda: bags.write(arguments.output, records, arguments.storage, arguments.force, ids),
        settings, arguments, report)


def write_with_parameters(
    write_bag: Callable[[], None], settings: Settings, arguments: Namespace,
    report: Iterable[str],
) -> None:
    """Write the bag by a function, and its parameters; then print a report, evaluated last."""
    path = Path(f'{arguments.output}.yaml')
    parameters.robot_names([robot.name for robot in settings.robots])
    with claimed(path, arguments.force):
        write_bag()
        write_text(path, parameters.dump(parameters.RunSettings(settings)))
    print('\n'.join([*report, f'wrote {arguments.output} and {path}']))
