# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Node: publishes odometry, landmark observations and ground truth of a synthetic world.

Give ROS arguments after --ros-args, the parameters with --params-file FILE or -p NAME:=VALUE.
"""

import argparse

from fej_slam_ros.cli.arguments import parameter_help
from fej_slam_ros.ros.session.simulation import PARAMETERS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = parameter_help(PARAMETERS)
