# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a set of MRCLAM, the UTIAS multi-robot data.

Read are Barcodes.dat, RobotN_Odometry.dat, RobotN_Measurement.dat and, where they are there,
RobotN_Groundtruth.dat or sparse_truth.csv, Landmark_Groundtruth_fixed.dat or
Landmark_Groundtruth.dat. A robot without odometry is left out. Noise is measured against
motion capture; where there is none it is that of set 6.
"""

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
import math

import numpy as np

from fej_slam_ros.cli import mrclam_tables
from fej_slam_ros.cli.conversion import add_places, write
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam import conversion, files, noise
from fej_slam_ros.datasets.mrclam.conversion import Reading, robot_name
from fej_slam_ros.datasets.mrclam.files import DataSet, RobotLog, ROBOTS
from fej_slam_ros.errors import UsageError, UserError

#: Odometry that is farther apart than this [s] is counted as a gap.
GAP = 0.4


def add_arguments(parser: ArgumentParser) -> None:
    """Declare how a set may be read."""
    usual = Reading()
    add_places(parser, output_required=False)
    parser.add_argument(
        '--measure', action='store_true',
        help='tell the errors of commands and camera by the ground truth, and convert nothing')
    parser.add_argument(
        '--motion-delay', metavar='SECONDS', type=_number(0.0, 10.0),
        help='how much later than commanded a robot moves (default: as measured, or'
        f' {usual.motion_delay:g} s without ground truth)')
    parser.add_argument(
        '--odometry-scale', metavar=('V', 'W'), nargs=2, type=_number(1e-3),
        help='true over commanded speed, ahead and turning (default: as measured, or'
        ' {:g} {:g})'.format(*usual.odometry_scale))
    parser.add_argument(
        '--thin', metavar='SECONDS', type=_number(0.0), default=usual.thin,
        help='for so long after an observation is the same subject not used again, because the errors'
        ' of the two would be nearly the same (default: %(default)g s, 0 takes all)')
    parser.add_argument(
        '--no-robot-observations', '--no-robot-sightings', dest='robot_observations', action='store_false',
        help='leave out that robots see each other')
    parser.add_argument(
        '--known-starts', action='store_true',
        help="give all robots' starts by the ground truth, not only the anchor's")
    parser.add_argument(
        '--range-sigma', metavar='RATIO', type=_number(1e-6),
        help='standard deviation of ranges per metre of range (default: as measured, or'
        f' {usual.noise.range:g} and, of robots, {usual.noise.robot_range:g})')
    parser.add_argument(
        '--bearing-sigma', metavar='RAD', type=_number(1e-6),
        help='standard deviation of bearings (default: as measured, or'
        f' {usual.noise.bearing:g} rad and, of robots, {usual.noise.robot_bearing:g} rad)')
    parser.set_defaults(convert=_convert)


def _convert(arguments: Namespace) -> int:
    if arguments.output is None and not arguments.measure:
        raise UsageError('nothing to do: give --output BAG, or --measure')
    data = files.read(arguments.input)
    if arguments.measure:
        return _measure(data, arguments)
    how = reading(data, arguments)
    counts = {robot: Counter[str]() for robot in data.logs}
    parameter_file = write(
        conversion.records(data, how, counts),
        conversion.settings(data, how, arguments.known_starts), arguments)
    print('\n'.join(account(data, how, counts)))
    print(f'wrote {arguments.output} and {parameter_file}')
    return 0


def _measure(data: DataSet, arguments: Namespace) -> int:
    if not noise.can_tell(data):
        raise UserError(
            f'{arguments.input} tells no noise: it needs Robot1_Groundtruth.dat and so on over'
            ' 50 s of odometry, and Landmark_Groundtruth.dat')
    print(mrclam_tables.noise_tables(data, reading(data, arguments)))
    return 0


def reading(data: DataSet, arguments: Namespace) -> Reading:
    """Return how a set is to be read: as told, else as measured, else as usual."""
    delay, scale = arguments.motion_delay, arguments.odometry_scale
    found = Reading()
    if noise.can_tell(data):
        found = noise.measured(data, delay, scale and tuple(scale))
    sigmas = found.noise
    if arguments.range_sigma is not None:
        sigmas = replace(sigmas, range=arguments.range_sigma, robot_range=arguments.range_sigma)
    if arguments.bearing_sigma is not None:
        sigmas = replace(
            sigmas, bearing=arguments.bearing_sigma, robot_bearing=arguments.bearing_sigma)
    return replace(
        found, noise=sigmas, thin=arguments.thin, robot_observations=arguments.robot_observations,
        motion_delay=found.motion_delay if delay is None else delay,
        odometry_scale=found.odometry_scale if scale is None else tuple(scale))


def account(data: DataSet, how: Reading, counts: Mapping[int, Counter[str]]) -> Iterator[str]:
    """Yield lines that tell what became of each robot's rows."""
    yield f'landmarks: {len(data.landmarks)}, from {data.landmark_file or "no file"}'
    for robot in ROBOTS:
        if robot in data.logs:
            log = data.logs[robot]
            told = log.counts + counts[robot]
            used = len(log.observations) - counts[robot].total()
            true = len(conversion.truth(log, how))
            yield (
                f'{robot_name(robot)}: odometry: {len(log.commands)} ({_gaps(log)}),'
                f' observations: {used}, true poses: {true} of {len(log.truth)}')
            yield from (f'    {reason}: {count}' for reason, count in told.items() if count)
        else:
            yield f'{robot_name(robot)} is left out: no two rows in Robot{robot}_Odometry.dat'


def _gaps(log: RobotLog) -> str:
    seconds = np.diff(log.commands.stamps) / NS
    return f'gaps above {GAP:g} s: {(seconds > GAP).sum()}, longest {seconds.max():.1f} s'


def _number(least: float, most: float = 1e6) -> Callable[[str], float]:
    """Return what reads a number in a range."""
    def read(word: str) -> float:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not least <= number <= most:
            raise ArgumentTypeError(f'{word} is not a number from {least:g} to {most:g}')
        return number
    return read
