# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Check a bag for problems that corrupt an estimate, and name the cure of each.

Checks: checksums of the files, topics and types, rates and gaps, order of stamps, clocks (robots
beside each other and beside the log time), late and duplicate data, frames, IDs, covariances,
jumps and units. A trial run of the estimator adds what it rejects, by the same names, robots that
never join the map, and contradictory measurements.

The exit status is 1 if there are errors, 0 if there are only warnings.
"""

import argparse
from dataclasses import asdict
from pathlib import Path

from fej_slam_ros.atomic_files import refuse_existing, write_json
from fej_slam_ros.cli.topic_options import add_topic_names, names_in, node_names
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.doctor.examination import examine
from fej_slam_ros.ros.doctor.findings import counted, Severity


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2')
    parser.add_argument(
        '--params', type=Path, metavar='FILE',
        help='ROS parameters (YAML) (default: robots of the topics, all else the defaults)')
    parser.add_argument(
        '--json', type=Path, metavar='FILE', help='also write the findings as JSON')
    parser.add_argument('--force', action='store_true', help='replace an earlier FILE')
    add_topic_names(parser)


def run(arguments: argparse.Namespace) -> int:
    """Check the bag and print the findings."""
    if arguments.json is not None:
        refuse_existing([arguments.json], arguments.force)
    settings = None if arguments.params is None else parameters.load(
        arguments.params, node_names(arguments, 'estimator'))
    findings = examine(arguments.bag, settings, names_in(arguments, arguments.bag))
    if arguments.json is not None:
        write_json(arguments.json, [asdict(finding) for finding in findings])
    for finding in findings:
        print(finding)
    errors = sum(finding.severity is Severity.ERROR for finding in findings)
    warnings = len(findings) - errors
    print(f'{arguments.bag}: {counted(errors, "error")}, {counted(warnings, "warning")}')
    return 1 if errors else 0
