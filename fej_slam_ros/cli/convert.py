# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a published data set into a rosbag2.

Beside the bag BAG comes BAG.yaml, the parameters to run it with:
fej_slam replay BAG --params BAG.yaml --output DIR
"""

from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from fej_slam_ros.cli import mrclam as mrclam_cli
from fej_slam_ros.core.records import Record
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets import mrclam, mrclam_noise, mrclam_records, victoria_park
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros import bags, parameters
from fej_slam_ros.writing import refuse_existing, write_text


def add_arguments(parser: ArgumentParser) -> None:
    """Declare the data sets, each with its options."""
    names = parser.add_subparsers(metavar='NAME', required=True)
    _add_victoria_park(names.add_parser(
        'victoria_park', allow_abbrev=False, help='Victoria Park, with its data association',
        description='Convert Victoria Park with its data association: Zstate_VicPark_6898_loops'
        '.mat or VicPark_clean_data.mat. Two robots are the two halves of the run in the paper on'
        ' FEJ-EKF SLAM, one is the whole log. Steps are put 0.2 s apart.'))
    _add_mrclam(names.add_parser(
        'mrclam', allow_abbrev=False, help='MRCLAM, five robots and their motion capture',
        description='Convert a set of MRCLAM, the UTIAS multi-robot data: Barcodes.dat,'
        ' RobotN_Odometry.dat, RobotN_Measurement.dat and, where they are there,'
        ' RobotN_Groundtruth.dat or sparse_truth.csv, Landmark_Groundtruth_fixed.dat or'
        ' Landmark_Groundtruth.dat. A robot without odometry is left out. The noise is measured'
        ' against the ground truth; where there is none it is that of sets 6 and 7.'))


def run(arguments: Namespace) -> int:
    """Convert the data set."""
    status: int = arguments.convert(arguments)
    return status


def _add_victoria_park(parser: ArgumentParser) -> None:
    _add_places(parser)
    parser.add_argument(
        '--robots', type=int, choices=sorted(victoria_park.TEAMS), default=2,
        help='how many robots the car stands for (default: %(default)s)')
    parser.set_defaults(convert=_convert_victoria_park)


def _convert_victoria_park(arguments: Namespace) -> int:
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


def _add_mrclam(parser: ArgumentParser) -> None:
    _add_places(parser, required=False)
    mrclam_cli.add_options(parser)
    parser.set_defaults(convert=_convert_mrclam)


def _convert_mrclam(arguments: Namespace) -> int:
    if arguments.output is None and not arguments.measure:
        raise UsageError('nothing to do: give --output BAG, or --measure')
    data = mrclam.read(arguments.input)
    if arguments.measure:
        return _measure_mrclam(data, arguments)
    how = mrclam_cli.reading(data, arguments)
    counts = {robot: Counter[str]() for robot in data.logs}
    parameter_file = _write(
        mrclam_records.records(data, how, counts),
        mrclam_records.settings(data, how, arguments.known_starts), arguments)
    print('\n'.join(mrclam_cli.account(data, counts)))
    print(f'wrote {arguments.output} and {parameter_file}')
    return 0


def _measure_mrclam(data: mrclam.DataSet, arguments: Namespace) -> int:
    if not mrclam_noise.can_tell(data):
        raise UserError(
            f'{arguments.input} tells no noise: it needs Robot1_Groundtruth.dat and so on, and'
            ' Landmark_Groundtruth.dat')
    print(mrclam_cli.noise_tables(data, mrclam_cli.reading(data, arguments)))
    return 0


def _add_places(parser: ArgumentParser, required: bool = True) -> None:
    """Declare what every data set needs to know."""
    parser.add_argument(
        '--input', metavar='DIR', type=Path, required=True, help='folder that holds the data set')
    parser.add_argument(
        '--output', metavar='BAG', type=Path, required=required, help='folder of the new bag')
    parser.add_argument(
        '--storage', choices=sorted(bags.STORAGES), default='mcap',
        help='format of the bag (default: %(default)s)')
    parser.add_argument(
        '--force', action='store_true', help='replace the bag and its parameters if they exist')


def _write(records: Iterable[Record], settings: Settings, arguments: Namespace) -> Path:
    """Write the bag and then its parameters; return the path of these."""
    path = Path(f'{arguments.output}.yaml')
    refuse_existing([path], arguments.force)
    numbers = {robot.name: robot.id for robot in settings.robots}
    bags.write(arguments.output, records, arguments.storage, arguments.force, numbers)
    write_text(path, parameters.dump(settings))
    return path
