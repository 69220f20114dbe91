# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Find what in a bag would spoil an estimate, and tell the cure.

Looked at are topics and types, rates and gaps, the order of stamps, clocks of robots beside each
other and the log time, late and duplicate data, frames, ids, covariances, jumps and units. The
estimator itself goes through the bag as well: what it refuses is told by the same names, and who
never comes into the map, and what contradicts itself.

An error would spoil the estimate, and the exit status is 1; with warnings alone it is 0.
"""

import argparse
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.atomic_files import refuse_existing, write_json
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.doctor.examination import examine
from fej_slam_ros.ros.doctor.findings import counted, ERROR, WARNING
from fej_slam_ros.ros.messages import RawMessage


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2')
    parser.add_argument(
        '--params', type=Path, metavar='FILE',
        help='ROS parameters (YAML) (default: the robots of the topics, else the defaults)')
    parser.add_argument(
        '--json', type=Path, metavar='FILE', help='also write the findings to a file')
    parser.add_argument('--force', action='store_true', help='replace that file if it exists')


def run(arguments: argparse.Namespace) -> int:
    """Examine the bag and print what was found."""
    if arguments.json is not None:
        refuse_existing([arguments.json], arguments.force)
    given = None if arguments.params is None else parameters.load(arguments.params)
    found = examine(arguments.bag, given, _progress)
    if arguments.json is not None:
        write_json(arguments.json, [asdict(finding) for finding in found])
    for finding in found:
        print(finding)
    errors, warnings = (
        sum(finding.severity == kind for finding in found) for kind in (ERROR, WARNING))
    print(f'{arguments.bag}: {counted(errors, "error")}, {counted(warnings, "warning")}')
    return 1 if errors else 0


def _progress(messages: Iterable[RawMessage], total: int) -> Iterable[RawMessage]:
    bar: Iterable[RawMessage] = tqdm(messages, total=total, unit='msg', disable=None)
    return bar
