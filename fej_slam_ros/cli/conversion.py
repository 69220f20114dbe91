# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the conversion of every data set asks for, and what it leaves."""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from pathlib import Path

from fej_slam_ros.atomic_files import refuse_existing, write_text
from fej_slam_ros.cli.arguments import add_storage
from fej_slam_ros.core.records import GpsFix, Record
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags


def add_places(parser: ArgumentParser, output_required: bool = True) -> None:
    """Declare where a data set is and where the bag goes."""
    parser.add_argument(
        '--input', metavar='DIR', type=Path, required=True, help='folder that holds the data set')
    parser.add_argument(
        '--output', metavar='BAG', type=Path, required=output_required,
        help='folder of the new bag')
    add_storage(parser)
    parser.add_argument(
        '--force', action='store_true', help='replace the bag and its parameters if they exist')


def write(records: Iterable[Record | GpsFix], settings: Settings, arguments: Namespace) -> Path:
    """Write the bag and then its parameters; return the path of these."""
    path = Path(f'{arguments.output}.yaml')
    refuse_existing([path], arguments.force)
    numbers = {robot.name: robot.id for robot in settings.robots}
    bags.write(arguments.output, records, arguments.storage, arguments.force, numbers)
    write_text(path, parameters.dump(parameters.RunSettings(settings)))
    return path
