# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Estimate from a bag without topics, as fast as the machine allows.

The estimator is that of the node: the same input gives the same numbers bit for bit.
"""

import argparse
from functools import partial

from fej_slam_ros.cli import offline_run
from fej_slam_ros.cli.run_table import run_table
from fej_slam_ros.cli.topic_options import node_names
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.session.estimator_outputs import EstimatorOutputs, NoOutputs
from fej_slam_ros.ros.session.estimator_session import EstimatorSession

add_arguments = offline_run.add_arguments


def run(arguments: argparse.Namespace) -> int:
    settings = parameters.load(arguments.params, node_names(arguments, 'estimator'))
    begin = partial(
        EstimatorSession, outputs=EstimatorOutputs if arguments.write_bag else NoOutputs)
    runs = offline_run.process(arguments, settings, 'estimator', begin)
    offline_run.print_tables(
        arguments, [session for session, _ in runs], [run_table(summary) for _, summary in runs])
    return 0
