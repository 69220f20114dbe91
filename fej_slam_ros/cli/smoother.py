# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Node: smooths the trajectories of all robots (C-SAM) and merges the maps of robots that met.

Give ROS arguments after --ros-args, the parameters with --params-file FILE or -p NAME:=VALUE.
"""

import argparse

from fej_slam_ros.cli.arguments import parameter_help
from fej_slam_ros.ros.parameters import known_parameters, SMOOTHER


def ignored_parameters() -> list[str]:
    """Return the names of the parameters that only the estimator reads."""
    used = known_parameters(audience=SMOOTHER)
    return [name for name in known_parameters() if name not in used]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    ignored = ''.join(f'  {name}\n' for name in ignored_parameters())
    parser.epilog = (
        f'{parameter_help(known_parameters(audience=SMOOTHER))}\n'
        f'ignored, of the estimator only:\n{ignored}')
