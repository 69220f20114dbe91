# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Node: publishes AprilTags, ArUco markers and objects of other packages as landmarks and robots.

Give ROS arguments after --ros-args, the parameters with --params-file FILE or -p NAME:=VALUE.
"""

import argparse

from fej_slam_ros.cli.arguments import parameter_help
from fej_slam_ros.ros.parameters.adapter_settings import known_parameters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = parameter_help(known_parameters())
