# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Estimate from a bag without topics, as fast as the machine allows.

The estimator is that of the node: the same input gives the same numbers bit for bit.
"""

import argparse

from fej_slam_ros.cli.offline_run import add_arguments, process
from fej_slam_ros.cli.run_table import run_table
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.session.estimator_session import EstimatorSession

__all__ = ['add_arguments', 'run']


def run(arguments: argparse.Namespace) -> int:
    """Replay the bag and print the table of each session."""
    settings = parameters.load(arguments.params)
    sessions = process(arguments, settings, 'estimator', EstimatorSession)
    print('\n\n'.join(run_table(summary) for _, summary in sessions))
    return 0
