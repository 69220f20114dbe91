# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a published data set into a rosbag2.

Beside the bag BAG comes BAG.yaml, the parameters to run it with:
fej_slam replay BAG --params BAG.yaml --output DIR
"""

from argparse import ArgumentParser, Namespace

from fej_slam_ros.cli import convert_mrclam, convert_victoria_park


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the data sets, each with its options."""
    names = parser.add_subparsers(metavar='NAME', required=True)
    convert_victoria_park.add_arguments(names.add_parser(
        'victoria_park', allow_abbrev=False, help='Victoria Park, associated or from the raw log',
        description=convert_victoria_park.__doc__))
    convert_mrclam.add_arguments(names.add_parser(
        'mrclam', allow_abbrev=False, help='MRCLAM, five robots and their motion capture',
        description=convert_mrclam.__doc__))


def run(arguments: Namespace) -> int:
    """Convert the data set."""
    status: int = arguments.convert(arguments)
    return status
