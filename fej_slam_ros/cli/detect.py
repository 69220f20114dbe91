# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Copy a bag and add the landmarks in its laser scans.

The landmarks are those that the node detector publishes, bit for bit, as long as odometry comes
within a second of its scans.
"""

import argparse
from collections.abc import Mapping
from functools import partial

from fej_slam_ros.cli.front_end_run import add_copy_arguments, write_copy
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.parameters.detector_settings import known_parameters, load_detector
from fej_slam_ros.ros.session.detector_session import DetectorSession
from fej_slam_ros.ros.topic_types import LASER_SCAN


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_copy_arguments(parser, known_parameters())


def run(arguments: argparse.Namespace) -> int:
    """Write the bag and print what was found and what was rejected."""
    session = DetectorSession(load_detector(arguments.params))
    write_copy(arguments, session, partial(_unusable, session))
    return 0


def _unusable(session: DetectorSession, topics: Mapping[str, bags.BagTopic]) -> str:
    """Return what a bag without scans of the robots has, and the cure."""
    if any(f'{name}/scan' in topics for name in session.robots):
        return ''
    scans = [name for name, topic in topics.items() if topic.type_name == LASER_SCAN]
    remap = f' /{scans[0]}:=/{next(iter(session.robots))}/scan' if len(scans) == 1 else ''
    return 'no <robot>/scan of the robots in robots, ' + (
        f'its scans are on {", ".join(scans)}: correct robots, or use --remap{remap}' if scans else
        'it has no laser scans')
