# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a published data set into a rosbag2.

Beside the bag BAG comes BAG.yaml, the parameters to run it with:
fej_slam replay BAG --params BAG.yaml --output DIR
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fej_slam_ros.core.records import GpsFix, Record
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets import (
    victoria_park, victoria_park_car, victoria_park_gps, victoria_park_log)
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros import bags, parameters
from fej_slam_ros.writing import refuse_existing, write_text


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the data sets, each with its options."""
    names = parser.add_subparsers(metavar='NAME', required=True)
    _add_victoria_park(names.add_parser(
        'victoria_park', allow_abbrev=False, help='Victoria Park, associated or from the raw log',
        description='Convert Victoria Park with its data association: Zstate_VicPark_6898_loops'
        '.mat or VicPark_clean_data.mat, steps 0.2 s apart. With --raw, convert what the car'
        ' measured, with its own stamps: aa3_dr.mat, aa3_gpsx.mat, detections.csv and'
        ' scan_time.csv. Two robots are the two halves of the run in the paper on FEJ-EKF SLAM,'
        ' one is the whole log.'))


def run(arguments: Namespace) -> int:
    """Convert the data set."""
    status: int = arguments.convert(arguments)
    return status


def _add_victoria_park(parser: ArgumentParser) -> None:
    _add_places(parser)
    parser.add_argument(
        '--robots', type=int, choices=sorted(victoria_park.TEAMS), default=2,
        help='how many robots the car stands for (default: %(default)s)')
    parser.add_argument(
        '--raw', action='store_true',
        help='take the raw log: odometry at 40 Hz, tree detections without identity, and GPS')
    parser.add_argument(
        '--identities', metavar='FILE', type=Path,
        help='with --raw: data_sensor_clean_clean.mat, which tells which tree each detection is')
    parser.set_defaults(convert=_convert_victoria_park)


def _convert_victoria_park(arguments: Namespace) -> int:
    if arguments.raw:
        return _convert_raw_victoria_park(arguments)
    if arguments.identities is not None:
        raise UsageError('--identities is for the raw log: give --raw, too')
    team = victoria_park.TEAMS[arguments.robots]
    source = victoria_park.find(arguments.input)
    logs = victoria_park.divide(victoria_park.read(source), team)
    parameter_file = _write(
        victoria_park.records(logs), victoria_park.settings(team), arguments)
    landmarks = {s.id for log in logs.values() for seen in log.sightings for s in seen}
    print(f'read {source}: robots: {len(logs)}, landmarks: {len(landmarks)}')
    for robot, log in logs.items():
        sightings = sum(map(len, log.sightings))
        print(f'{robot}: steps: {len(log.increments)}, sightings: {sightings}')
    print(f'wrote {arguments.output} and {parameter_file}')
    return 0


def _convert_raw_victoria_park(arguments: Namespace) -> int:
    log = victoria_park_log.read(arguments.input)
    if arguments.identities is not None:
        log = replace(log, scans=victoria_park_log.identified(log.scans, arguments.identities))
    team = victoria_park_car.drives(log, arguments.robots)
    parameter_file = _write(
        victoria_park_car.records(team), victoria_park_car.settings(team), arguments)
    print(f'read {arguments.input}: robots: {len(team)}')
    for robot, drive in team.items():
        scans, fixes = drive.log.scans, drive.log.fixes
        unknown = int((scans.ids == victoria_park_log.UNKNOWN).sum())
        gaps = int((np.diff(fixes.stamps) > victoria_park_gps.MAX_GAP).sum())
        print(
            f'{robot}: odometry: {len(drive.poses)}, scans: {len(scans.stamps)},'
            f' detections: {len(scans.ids)} ({unknown} without identity),'
            f' GPS: {len(fixes.stamps)} ({gaps} gaps, {drive.is_doubted.sum()} fixes doubted)')
    print(f'wrote {arguments.output} and {parameter_file}')
    return 0


def _add_places(parser: ArgumentParser) -> None:
    """Declare what every data set needs to know."""
    parser.add_argument(
        '--input', metavar='DIR', type=Path, required=True, help='folder that holds the data set')
    parser.add_argument(
        '--output', metavar='BAG', type=Path, required=True, help='folder of the new bag')
    parser.add_argument(
        '--storage', choices=sorted(bags.STORAGES), default='mcap',
        help='format of the bag (default: %(default)s)')
    parser.add_argument(
        '--force', action='store_true', help='replace the bag and its parameters if they exist')


def _write(
    records: Iterable[Record | GpsFix], settings: Settings, arguments: Namespace
) -> Path:
    """Write the bag and then its parameters; return the path of these."""
    path = Path(f'{arguments.output}.yaml')
    refuse_existing([path], arguments.force)
    bags.write(arguments.output, records, arguments.storage, arguments.force)
    write_text(path, parameters.dump(settings))
    return path
