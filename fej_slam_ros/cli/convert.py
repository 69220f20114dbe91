# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a data set, or bags of single robots, into a rosbag2.

BAG.yaml beside the bag holds the parameters to run it with, as in
  replay BAG --params BAG.yaml --output DIR
"""

from argparse import ArgumentParser, Namespace

from fej_slam_ros.cli.converters import csv_tables, g2o, mrclam, robot_bags, victoria_park

#: Converters by the name of their data set; `converters` says how to add one.
CONVERTERS = {
    'victoria_park': victoria_park, 'mrclam': mrclam, 'g2o': g2o, 'csv': csv_tables,
    'robot_bags': robot_bags}


def add_arguments(parser: ArgumentParser) -> None:
    names = parser.add_subparsers(metavar='NAME', required=True)
    for name, converter in CONVERTERS.items():
        of_set = names.add_parser(
            name, allow_abbrev=False, help=converter.SUMMARY, description=converter.__doc__)
        converter.add_arguments(of_set)
        of_set.set_defaults(convert=converter.convert)


def run(arguments: Namespace) -> int:
    arguments.convert(arguments)
    return 0
