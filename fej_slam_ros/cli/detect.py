# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Copy a bag and add the landmarks in its laser scans.

The landmarks are those that the node detector publishes, bit for bit, as long as odometry comes
within a second of its scans.
"""

import argparse

from fej_slam_ros.cli.front_end_run import add_copy_arguments, check_output, write_copy
from fej_slam_ros.cli.topic_options import names_in
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.parameters.detector_settings import known_parameters, load_detector
from fej_slam_ros.ros.session.detector_session import DetectorSession, LASER_SCAN


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_copy_arguments(parser, known_parameters())


def run(arguments: argparse.Namespace) -> int:
    """Write the bag and print what was found and what was rejected."""
    session = DetectorSession(load_detector(arguments.params))
    names = names_in(arguments, arguments.bag)
    topics = bags.topics(arguments.bag, names)
    check_output(arguments, session, topics)
    if not any(f'{name}/scan' in topics for name in session.robots):
        scans = [name for name, topic in topics.items() if topic.type_name == LASER_SCAN]
        found = (
            f'its scans are on {", ".join(scans)}: correct robots, or use --remap' if scans else
            'it has no laser scans')
        raise UserError(f'{arguments.bag} has no <robot>/scan of the robots in robots, {found}')
    write_copy(arguments, session, topics, names)
    return 0
