# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Estimate from a bag without topics, as fast as the machine allows.

The estimator is that of the node: the same input gives the same numbers bit for bit.
"""

import argparse

from fej_slam_ros.cli import offline_run
from fej_slam_ros.cli.run_table import run_table
from fej_slam_ros.cli.topic_options import node_names
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.session.estimator_session import EstimatorSession

add_arguments = offline_run.add_arguments


def run(arguments: argparse.Namespace) -> int:
    settings = parameters.load(arguments.params, node_names(arguments, 'estimator'))
    sessions = offline_run.process(arguments, settings, 'estimator', EstimatorSession)
    print('\n\n'.join(run_table(summary) for _, summary in sessions))
    return 0
