# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Play a bag onto its topics, for machines without ros2 bag.

Publishers are reliable. Playback begins when every topic of the bag has a subscriber.
"""

import argparse
from pathlib import Path

from fej_slam_ros.cli.topic_options import add_topic_names, names_in


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2')
    parser.add_argument(
        '--rate', type=float, default=1.0, metavar='R', help='playback speed (default: 1.0)')
    parser.add_argument(
        '--clock', action='store_true',
        help="publish the bag's time on /clock, unless the bag has that topic")
    parser.add_argument('--no-wait', action='store_true', help='do not wait for subscribers')
    add_topic_names(parser)


def run(arguments: argparse.Namespace) -> int:
    from fej_slam_ros.ros.nodes.play import main

    names = names_in(arguments, arguments.bag, is_played=True)
    return main(arguments.bag, names, arguments.rate, arguments.clock, not arguments.no_wait)
