# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Node: fuses odometry and landmark observations of all robots into poses and a map.

Give ROS arguments after --ros-args, the parameters with --params-file FILE or -p NAME:=VALUE.
"""

import argparse

from fej_slam_ros.cli.arguments import parameter_help
from fej_slam_ros.ros.parameters import ESTIMATOR, known_parameters


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = parameter_help(known_parameters(audience=ESTIMATOR))
