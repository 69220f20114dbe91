# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert Victoria Park, one car that may stand for two robots.

Without --raw with its data association: Zstate_VicPark_6898_loops.mat or VicPark_clean_data.mat,
steps 0.2 s apart. With --raw what the car measured, with its own stamps: aa3_dr.mat, aa3_gpsx.mat,
detections.csv and scan_time.csv. Two robots are the two halves of the run in the paper on FEJ-EKF
SLAM, one is the whole log.
"""

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from fej_slam_ros.cli.conversion import add_places, write
from fej_slam_ros.datasets.victoria_park import associated_log, car, gps, raw_log
from fej_slam_ros.errors import UsageError


def add_arguments(parser: ArgumentParser) -> None:
    """Declare what may be converted."""
    add_places(parser)
    parser.add_argument(
        '--robots', type=int, choices=sorted(associated_log.TEAMS), default=2,
        help='how many robots the car stands for (default: %(default)s)')
    parser.add_argument(
        '--raw', action='store_true',
        help='take the raw log: odometry at 40 Hz, tree detections without identity, and GPS')
    parser.add_argument(
        '--identities', metavar='FILE', type=Path,
        help='with --raw: data_sensor_clean_clean.mat, which tells which tree each detection is')
    parser.set_defaults(convert=_convert)


def _convert(arguments: Namespace) -> int:
    if arguments.raw:
        return _convert_raw(arguments)
    if arguments.identities is not None:
        raise UsageError('--identities is for the raw log: give --raw, too')
    team = associated_log.TEAMS[arguments.robots]
    source = associated_log.find(arguments.input)
    logs = associated_log.divide(associated_log.read(source), team)
    parameter_file = write(
        associated_log.records(logs), associated_log.settings(team), arguments)
    landmarks = {s.id for log in logs.values() for seen in log.observations for s in seen}
    print(f'read {source}: robots: {len(logs)}, landmarks: {len(landmarks)}')
    for robot, log in logs.items():
        observations = sum(map(len, log.observations))
        print(f'{robot}: steps: {len(log.increments)}, observations: {observations}')
    print(f'wrote {arguments.output} and {parameter_file}')
    return 0


def _convert_raw(arguments: Namespace) -> int:
    log = raw_log.read(arguments.input)
    if arguments.identities is not None:
        log = replace(log, scans=raw_log.identified(log.scans, arguments.identities))
    team = car.drives(log, arguments.robots)
    parameter_file = write(
        car.records(team), car.settings(team), arguments)
    print(f'read {arguments.input}: robots: {len(team)}')
    for robot, drive in team.items():
        scans, fixes = drive.log.scans, drive.log.fixes
        unknown = int((scans.ids == raw_log.UNKNOWN).sum())
        gaps = int((np.diff(fixes.stamps) > gps.MAX_GAP).sum())
        print(
            f'{robot}: odometry: {len(drive.poses)}, scans: {len(scans.stamps)},'
            f' detections: {len(scans.ids)} ({unknown} without identity),'
            f' GPS: {len(fixes.stamps)} ({gaps} gaps, {drive.is_doubted.sum()} fixes doubted)')
    print(f'wrote {arguments.output} and {parameter_file}')
    return 0
