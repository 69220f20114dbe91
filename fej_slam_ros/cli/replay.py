# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Estimate from a bag without topics, as fast as the machine allows.

The same estimator as the node's: given the same input, the same numbers bit for bit.
"""

import argparse

from fej_slam_ros.cli.offline_run import add_arguments, process
from fej_slam_ros.cli.run_table import run_table
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.session.estimator_session import EstimatorSession

__all__ = ['add_arguments', 'run']


def run(arguments: argparse.Namespace) -> int:
    """Replay the bag and print what came of it."""
    settings = parameters.load(arguments.params)
    made = process(arguments, settings, 'estimator', EstimatorSession)
    print('\n\n'.join(run_table(told) for _, told in made))
    return 0
