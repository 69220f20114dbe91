# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a set of MRCLAM, the UTIAS multi-robot data.

Read are Barcodes.dat, RobotN_Odometry.dat, RobotN_Measurement.dat and, where they are there,
RobotN_Groundtruth.dat or sparse_truth.csv, Landmark_Groundtruth_fixed.dat or
Landmark_Groundtruth.dat. A robot without odometry is left out. The noise is measured against the
ground truth; where there is none it is that of sets 6 and 7.
"""

from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
import math

import numpy as np

from fej_slam_ros.cli.conversion import add_places, write
from fej_slam_ros.cli.table import format_table
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets import mrclam, mrclam_noise, mrclam_records
from fej_slam_ros.datasets.mrclam import DataSet, Log, ROBOTS
from fej_slam_ros.datasets.mrclam_records import Reading, robot_name
from fej_slam_ros.errors import UsageError, UserError

#: Windows [s] over which speeds are averaged in the table.
WINDOWS = (0.2, 1.0, 5.0)

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
        '--motion-delay', metavar='SECONDS', type=_number(-10.0),
        help='how much later than commanded a robot moves (default: as measured, or'
        f' {usual.motion_delay:g} s without ground truth)')
    parser.add_argument(
        '--odometry-scale', metavar=('V', 'W'), nargs=2, type=_number(1e-3),
        help='true over commanded speed, ahead and turning (default: as measured, or'
        ' {:g} {:g})'.format(*usual.odometry_scale))
    parser.add_argument(
        '--thin', metavar='SECONDS', type=_number(0.0), default=usual.thin,
        help='for so long after a sighting is the same subject not used again, because the errors'
        ' of the two would be nearly the same (default: %(default)g s, 0 takes all)')
    parser.add_argument(
        '--no-robot-sightings', dest='robot_sightings', action='store_false',
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
    data = mrclam.read(arguments.input)
    if arguments.measure:
        return _measure(data, arguments)
    how = reading(data, arguments)
    counts = {robot: Counter[str]() for robot in data.logs}
    parameter_file = write(
        mrclam_records.records(data, how, counts),
        mrclam_records.settings(data, how, arguments.known_starts), arguments)
    print('\n'.join(account(data, counts)))
    print(f'wrote {arguments.output} and {parameter_file}')
    return 0


def _measure(data: DataSet, arguments: Namespace) -> int:
    if not mrclam_noise.can_tell(data):
        raise UserError(
            f'{arguments.input} tells no noise: it needs Robot1_Groundtruth.dat and so on, and'
            ' Landmark_Groundtruth.dat')
    print(noise_tables(data, reading(data, arguments)))
    return 0


def reading(data: DataSet, arguments: Namespace) -> Reading:
    """Return how a set is to be read: as told, else as measured, else as usual."""
    delay, scale = arguments.motion_delay, arguments.odometry_scale
    found = Reading()
    if mrclam_noise.can_tell(data):
        found = mrclam_noise.measured(data, delay, scale and tuple(scale))
    noise = found.noise
    if arguments.range_sigma is not None:
        noise = replace(noise, range=arguments.range_sigma, robot_range=arguments.range_sigma)
    if arguments.bearing_sigma is not None:
        noise = replace(
            noise, bearing=arguments.bearing_sigma, robot_bearing=arguments.bearing_sigma)
    return replace(
        found, noise=noise, thin=arguments.thin, robot_sightings=arguments.robot_sightings,
        motion_delay=found.motion_delay if delay is None else delay,
        odometry_scale=found.odometry_scale if scale is None else tuple(scale))


def account(data: DataSet, counts: Mapping[int, Counter[str]]) -> Iterable[str]:
    """Yield lines that tell what became of each robot's rows."""
    yield f'landmarks: {len(data.landmarks)}, from {data.landmark_file or "no file"}'
    for robot in ROBOTS:
        if robot in data.logs:
            log = data.logs[robot]
            told = log.counts + counts[robot]
            used = len(log.sightings) - counts[robot].total()
            yield (
                f'{robot_name(robot)}: odometry: {len(log.commands)} ({_gaps(log)}),'
                f' sightings: {used}, true poses: {len(log.truth)}')
            yield from (f'    {reason}: {count}' for reason, count in told.items() if count)
        else:
            yield f'{robot_name(robot)} is left out: no rows in Robot{robot}_Odometry.dat'


def noise_tables(data: DataSet, how: Reading) -> str:
    """Return the errors of commands and camera as text."""
    tables = [_setting_table(how), _speed_table(data, how), _sighting_table(data)]
    return '\n\n'.join(format_table(list(table)) for table in tables)


def _setting_table(how: Reading) -> Iterable[tuple[str, ...]]:
    noise = how.noise
    yield 'commands', 'ahead', 'turning'
    yield 'delay [s]', f'{how.motion_delay:.2f}', f'{how.motion_delay:.2f}'
    yield ('true over commanded speed', *(f'{scale:.3f}' for scale in how.odometry_scale))
    for metres, what in enumerate(('metre driven', 'radian turned')):
        yield (
            f'variance per {what} [m^2, rad^2]',
            f'{noise.way[metres]:.5f}', f'{noise.heading[metres]:.5f}')


def _speed_table(data: DataSet, how: Reading) -> Iterable[tuple[str, ...]]:
    yield (
        'speed error sd', *(f'{unit} in {window:g} s' for unit in ('m/s', 'rad/s')
                            for window in WINDOWS))
    alone = {robot_name(k): replace(data, logs={k: log}) for k, log in data.logs.items()}
    for who, some in {**alone, 'all': data}.items():
        errors = [mrclam_noise.increments(some, how, window).errors() for window in WINDOWS]
        if all(map(len, errors)):
            sds = [e.std(axis=0) / window for e, window in zip(errors, WINDOWS)]
            yield (who, *(f'{sd[axis]:.3f}' for axis in (0, 2) for sd in sds))


def _sighting_table(data: DataSet) -> Iterable[tuple[str, ...]]:
    kinds = dict(zip(('of landmarks', 'of robots'), mrclam_noise.sighting_errors(data)))
    here = {kind: errors for kind, errors in kinds.items() if len(errors.ranges)}
    found = [mrclam_noise.sighting_noise(errors) for errors in here.values()]
    yield ('sightings', *here)
    yield ('count', *(str(noise.count) for noise in found))
    yield ('gross [%]', *(f'{100 * noise.gross / noise.count:.2f}' for noise in found))
    for what, form, field in (
        ('range sd [m]', '.3f', 'range_sd'), ('range mean [m]', '.3f', 'range_mean'),
        ('range rms per metre', '.4f', 'range_growth'), ('bearing sd [rad]', '.4f', 'bearing_sd'),
        ('bearing mean [rad]', '.4f', 'bearing_mean'), ('bearing rms [rad]', '.4f', 'bearing_rms'),
    ):
        yield (what, *(format(getattr(noise, field), form) for noise in found))
    for low, high in mrclam_noise.LAGS:
        yield (
            f'correlation of range errors {low:g} to {high:g} s apart',
            *(f'{noise.correlation[low, high]:.2f}' for noise in found))


def _gaps(log: Log) -> str:
    seconds = np.diff(log.commands.stamps) / NS
    longest = f'{seconds.max():.1f} s' if len(seconds) else '-'
    return f'gaps above {GAP:g} s: {int((seconds > GAP).sum())}, longest {longest}'


def _number(least: float) -> Callable[[str], float]:
    """Return what reads a finite number that is not too small."""
    def read(word: str) -> float:
        try:
            number = float(word)
        except ValueError:
            number = math.nan
        if not least <= number < math.inf:
            raise ArgumentTypeError(f'{word} is not a number from {least:g} on')
        return number
    return read
