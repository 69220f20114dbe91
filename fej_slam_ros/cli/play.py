# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Play a bag onto its topics, for machines without ros2 bag.

Publishers are reliable. Playback begins when every topic of the bag has a subscriber.
"""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2')
    parser.add_argument(
        '--rate', type=float, default=1.0, metavar='R', help='playback speed (default: 1.0)')
    parser.add_argument('--clock', action='store_true', help="publish the bag's time on /clock")
    parser.add_argument('--no-wait', action='store_true', help='do not wait for subscribers')


def run(arguments: argparse.Namespace) -> int:
    from fej_slam_ros.ros.nodes.play import main

    return main(arguments.bag, arguments.rate, arguments.clock, not arguments.no_wait)
