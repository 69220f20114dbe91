# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert Victoria Park, one car that may stand for two robots.

Without --raw, the associated log: Zstate_VicPark_6898_loops.mat or VicPark_clean_data.mat, steps
0.2 s apart. With --raw, the raw log with its own stamps: aa3_dr.mat, aa3_gpsx.mat, detections.csv
and scan_time.csv, or inputs.dat, measurements.dat and gps.dat of RFS-SLAM. Two robots are the two
halves of the run, as in the paper on FEJ-EKF SLAM; one robot is the whole log.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from fej_slam_ros.cli.converters.common import add_paths, write
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.datasets.victoria_park import (
    associated_log, gps, raw_conversion, raw_log, text_log)
from fej_slam_ros.errors import UsageError

SUMMARY = 'Victoria Park, the associated or the raw log'


def add_arguments(parser: ArgumentParser) -> None:
    add_paths(parser)
    parser.add_argument(
        '--robots', type=int, choices=sorted(associated_log.CAR_TEAMS), default=2,
        help='number of robots that the car stands for (default: %(default)s)')
    parser.add_argument(
        '--raw', action='store_true',
        help='convert the raw log: odometry at 40 Hz, tree detections without ID, and GPS')
    parser.add_argument(
        '--identities', metavar='FILE', type=Path,
        help='with --raw: data_sensor_clean_clean.mat, the tree ID of each detection')


def convert(arguments: Namespace) -> None:
    """Write the bag and print the number of its records."""
    if arguments.raw:
        _convert_raw(arguments)
        return
    if arguments.identities is not None:
        raise UsageError('--identities is for the raw log: give --raw as well')
    team = associated_log.CAR_TEAMS[arguments.robots]
    source = associated_log.find(arguments.input)
    logs = associated_log.divide(associated_log.read(source), team)
    landmarks = {s.id for log in logs.values() for seen in log.observations for s in seen}
    write(associated_log.records(logs), associated_log.settings(team), arguments, [
        f'read {source}: robots: {len(logs)}, landmarks: {len(landmarks)}',
        *(f'{robot}: steps: {len(log.increments)},'
          f' observations: {sum(map(len, log.observations))}' for robot, log in logs.items())])


def _convert_raw(arguments: Namespace) -> None:
    form = text_log if text_log.is_in(arguments.input) else raw_log
    log = form.read(arguments.input)
    if arguments.identities is not None:
        log = replace(log, trees=raw_log.with_ids(log.trees, arguments.identities))
    team = raw_conversion.drives(log, arguments.robots)
    write(
        raw_conversion.records(team), raw_conversion.settings(team), arguments,
        _raw_report(arguments.input, team))


def _raw_report(source: Path, team: Mapping[str, raw_conversion.CarDrive]) -> Iterator[str]:
    yield f'read {source}: robots: {len(team)}'
    for robot, drive in team.items():
        trees, fixes = drive.log.trees, drive.log.fixes
        unknown = int((trees.ids == NO_ID).sum())
        gaps = int((np.diff(fixes.stamps) > gps.MAX_FIX_GAP).sum())
        yield (
            f'{robot}: odometry: {len(drive.poses)}, scans: {len(trees.stamps)},'
            f' detections: {len(trees.ids)} ({unknown} without ID),'
            f' GPS: {len(fixes.stamps)} ({gaps} gaps, {drive.is_outlier.sum()} doubtful fixes)')
