# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Check a bag for problems that corrupt an estimate, and name the cure of each.

Checks: checksums of the files, topics and types, rates and gaps, order of stamps, clocks (robots
beside each other and beside the log time), late and duplicate data, frames, IDs, covariances,
jumps and units. A trial run of the estimator adds what it rejects, by the same names, robots that
never join the map, and contradictory measurements.

The exit status is 1 if there are errors, 0 if there are only warnings.

doctor --system checks this machine instead: it lists the shared memory that killed nodes have left
in /dev/shm. With --delete-stale it deletes what no process uses; other nodes may run meanwhile.
"""

import argparse
from dataclasses import asdict
from pathlib import Path

from fej_slam_ros.atomic_files import write_json
from fej_slam_ros.cli.topic_options import add_topic_names, names_in, node_names
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.errors import UsageError
from fej_slam_ros.output_lock import claimed
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.doctor import shared_memory
from fej_slam_ros.ros.doctor.examination import examine
from fej_slam_ros.ros.doctor.findings import Severity


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('bag', type=Path, metavar='BAG', nargs='?', help='folder of a rosbag2')
    parser.add_argument(
        '--system', action='store_true', help='check the shared memory of this machine, not a bag')
    parser.add_argument(
        '--delete-stale', action='store_true',
        help='with --system: delete shared memory that no process uses')
    parser.add_argument(
        '--params', type=Path, metavar='FILE',
        help='ROS parameters (YAML) (default: robots of the topics, all else the defaults)')
    parser.add_argument(
        '--json', type=Path, metavar='FILE', help='also write the findings as JSON')
    parser.add_argument('--force', action='store_true', help='replace an earlier FILE')
    add_topic_names(parser)


def run(arguments: argparse.Namespace) -> int:
    """Check the bag, or the system, and print the findings."""
    if arguments.system != (arguments.bag is None) or arguments.delete_stale > arguments.system:
        raise UsageError('give either BAG, or --system with or without --delete-stale')
    if arguments.system:
        if arguments.params or arguments.json or arguments.remap or arguments.namespace:
            raise UsageError('--params, --json, --remap and --namespace are for a BAG')
        return _check_system(arguments.delete_stale)
    with claimed(arguments.json, arguments.force):
        return _examine(arguments)


def _examine(arguments: argparse.Namespace) -> int:
    settings = None if arguments.params is None else parameters.load(
        arguments.params, node_names(arguments, 'estimator'))
    findings = examine(
        arguments.bag, settings, names_in(arguments, arguments.bag), arguments.params)
    if arguments.json is not None:
        write_json(arguments.json, [asdict(finding) for finding in findings])
    for finding in findings:
        print(finding)
    errors = sum(finding.severity is Severity.ERROR for finding in findings)
    warnings = len(findings) - errors
    print(f'{arguments.bag}: {counted(errors, "error")}, {counted(warnings, "warning")}')
    return 1 if errors else 0


def _check_system(deletes: bool) -> int:
    """List the stale shared memory of Fast DDS, and delete it if asked to."""
    found = shared_memory.survey()
    stale = [memory for memory in found if memory.is_stale]
    for memory in stale:
        if deletes:
            shared_memory.delete(memory)
        print(f'{"deleted" if deletes else "stale"}: {memory.name}: {memory.size / 1000:.0f} kB')
    megabytes = sum(memory.size for memory in stale) / 1e6
    print(
        f'{shared_memory.FOLDER}: {len(found)} segments and ports of Fast DDS,'
        f' {sum(memory.is_used for memory in found)} in use, {len(stale)} stale'
        f' ({megabytes:.1f} MB){" deleted" if deletes else ""},'
        f' {sum(not memory.is_own for memory in found)} of other users')
    if stale and not deletes:
        print('    cure: fej_slam doctor --system --delete-stale')
    return 0
