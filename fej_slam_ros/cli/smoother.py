# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Node: odometry, observations and rendezvous of all robots in, smoothed ways and joined map out.

Give ROS arguments after --ros-args, the parameters with --params-file FILE or -p NAME:=VALUE.
"""

import argparse

from fej_slam_ros.cli.arguments import parameter_help
from fej_slam_ros.ros.parameters import describe

#: Parameters that mean nothing to a smoother.
IGNORED = (
    'anchor_sigma', 'filter', 'update_iterations', 'compressed', 'start_covariance',
    'match_probability', 'inflate_rejected_scans', 'moved_landmarks', 'join_heading_sigma', 'prior_landmarks',
    'relative_poses', 'publish_tf', 'checkpoint', 'autosave_period', 'restore',
    '<robot>.start_pose', '<robot>.start_sigma')
IGNORED_HELP = "ignored, as they are the estimator's:\n" + ''.join(
    f'  {name}\n' for name in IGNORED)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the help tells of the parameters."""
    meanings = {name: told for name, told in describe().items() if name not in IGNORED}
    parser.epilog = f'{parameter_help(meanings)}\n{IGNORED_HELP}'


def run(arguments: argparse.Namespace) -> int:
    """Run the node."""
    from fej_slam_ros.ros.nodes.smoother import main

    return main(arguments.ros_args)
