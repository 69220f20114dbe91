# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Write a simulated run as a bag, with the messages that the simulator node publishes.

The same parameters give the same world, noise and ground truth.
"""

import argparse
from pathlib import Path

from fej_slam_ros.cli.arguments import add_output_bag, parameter_help
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.session import simulation


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        '--params', type=Path, metavar='FILE', help='ROS parameters of the simulator (YAML)')
    add_output_bag(parser, 'folder of the rosbag2')
    parser.epilog = parameter_help(simulation.PARAMETERS)


def run(arguments: argparse.Namespace) -> int:
    path = arguments.params
    simulated = simulation.parse({}) if path is None else simulation.load(path)
    bags.write(
        arguments.output, simulated.records(), arguments.storage, arguments.force,
        simulated.robot_ids)
    print(f'wrote {arguments.output}')
    return 0
