# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a set of MRCLAM, the UTIAS multi-robot data.

Files: Barcodes.dat, RobotN_Odometry.dat, RobotN_Measurement.dat and, if present,
RobotN_Groundtruth.dat or sparse_truth.csv, Landmark_Groundtruth_fixed.dat or
Landmark_Groundtruth.dat. A robot without odometry is left out. Noise is measured against motion
capture; without it, the noise of set 6 is used.
"""

from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain

import numpy as np

from fej_slam_ros.cli.arguments import number_option, OldFlag
from fej_slam_ros.cli.converters import mrclam_tables
from fej_slam_ros.cli.converters.common import add_paths, write
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets.mrclam import camera_errors, conversion, files, noise, run_settings
from fej_slam_ros.datasets.mrclam.camera_errors import MAX_CAMERA_DELAY
from fej_slam_ros.datasets.mrclam.command_errors import MAX_MOTION_DELAY
from fej_slam_ros.datasets.mrclam.conversion import MAX_COMMAND_HOLD, robot_name
from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions, range_increase
from fej_slam_ros.datasets.mrclam.files import (
    MrclamSet, REPLACED_COMMAND, ROBOT_SUBJECTS, RobotLog, UNKNOWN_CODE)
from fej_slam_ros.errors import UsageError, UserError

SUMMARY = 'MRCLAM, five robots and their motion capture'

#: Lower bound of a reported gap in odometry [s]; commands are several times as frequent.
REPORTED_GAP = 0.4
#: Share of the time without a command in force above which it is reported.
REPORTED_UNKNOWN_SHARE = 0.2
#: Minimum number of observations whose stamps are whole seconds by no chance.
MIN_WHOLE_SECONDS = 10
#: Distance of a measured delay from the end of its search [s] up to which the true one is beyond.
END_OF_SEARCH = 0.02


def add_arguments(parser: ArgumentParser) -> None:
    default = ConversionOptions()
    add_paths(parser, output_required=False)
    parser.add_argument(
        '--measure', action='store_true',
        help='print the errors of commands and camera, and convert nothing')
    parser.add_argument(
        '--motion-delay', metavar='SECONDS', type=number_option('--motion-delay', 0.0, 10.0),
        help='delay from command to motion (default: as measured, or'
        f' {default.motion_delay:g} s without ground truth)')
    parser.add_argument(
        '--camera-delay', metavar='SECONDS', type=number_option('--camera-delay', 0.0, 10.0),
        help='delay from an image to the stamp of its observations (default: as measured, or'
        f' {default.camera_delay:g} s without ground truth)')
    parser.add_argument(
        '--odometry-scale', metavar=('V', 'W'), nargs=2,
        type=number_option('--odometry-scale', 1e-3),
        help='true over commanded speed, ahead and turning'
        ' (default: as measured, or {:g} {:g})'.format(*default.odometry_scale))
    parser.add_argument(
        '--thin', metavar='SECONDS', type=number_option('--thin', 0.0), default=default.thin,
        help='minimum time between observations of a subject (default: %(default)g s; 0: use all)')
    parser.add_argument(
        '--correlation-factor', metavar='FACTOR',
        type=number_option('--correlation-factor', 1e-3),
        help='factor on the standard deviations of observations, since the errors of those that'
        ' --thin leaves persist (default: as measured, or'
        f' {default.correlation_factor:g} without ground truth)')
    parser.add_argument(
        '--no-robot-observations', dest='robot_observations', action='store_false',
        help='leave out robot-to-robot observations')
    parser.add_argument(
        '--no-robot-sightings', dest='robot_observations', action=OldFlag,
        present='--no-robot-observations')
    parser.add_argument(
        '--known-starts', action='store_true',
        help="give all robots' initial poses from the ground truth, not only the anchor's")
    parser.add_argument(
        '--range-sigma', metavar='RATIO', type=number_option('--range-sigma', 1e-6),
        help='standard deviation of ranges per metre of range, without a constant part (default:'
        ' as measured, or'
        f' {default.noise.landmarks.range:g} and, of robots, {default.noise.robots.range:g})')
    parser.add_argument(
        '--bearing-sigma', metavar='RAD', type=number_option('--bearing-sigma', 1e-6),
        help='standard deviation of bearings (default: as measured, or'
        f' {default.noise.landmarks.bearing:g} rad and, of robots,'
        f' {default.noise.robots.bearing:g} rad)')


def convert(arguments: Namespace) -> None:
    """Write the bag and print the number of its records, or print the measured noise."""
    if arguments.output is None and not arguments.measure:
        raise UsageError('nothing to do: give --output BAG, or --measure')
    if arguments.output is not None and arguments.measure:
        raise UsageError('--measure converts nothing: leave out --output, or --measure')
    data = files.read(arguments.input)
    if arguments.measure and not (data.landmarks and noise.is_measurable(data)):
        raise UserError(
            f'{arguments.input} is not enough to measure noise: it needs Robot1_Groundtruth.dat'
            ' and so on over 50 s of odometry, and Landmark_Groundtruth.dat')
    options = _options(data, arguments)
    if arguments.measure:
        print(mrclam_tables.noise_tables(data, options))
        return
    data = run_settings.with_known_anchor(data, options)
    rejected = {robot: Counter[str]() for robot in data.logs}
    settings = run_settings.settings(data, options, arguments.known_starts)
    write(
        conversion.records(data, options, rejected), settings, arguments,
        chain(_report(data, options, settings, rejected), _clock_faults(data, options, arguments)))


def _options(data: MrclamSet, arguments: Namespace) -> ConversionOptions:
    """Return the options as given by arguments, else as measured, else the defaults."""
    delay, scale = arguments.motion_delay, arguments.odometry_scale
    options = noise.best_options(
        data, delay, scale and tuple(scale), arguments.camera_delay, arguments.thin)
    cameras, increases = [options.noise.landmarks, options.noise.robots], options.range_increases
    if arguments.range_sigma is not None:
        cameras = [
            replace(camera, range=arguments.range_sigma, range_constant=0.0)
            for camera in cameras]
        increases = (range_increase(arguments.range_sigma),) * 2
    if arguments.bearing_sigma is not None:
        cameras = [replace(camera, bearing=arguments.bearing_sigma) for camera in cameras]
    return replace(
        options, noise=replace(options.noise, landmarks=cameras[0], robots=cameras[1]),
        range_increases=increases,
        correlation_factor=arguments.correlation_factor or options.correlation_factor,
        robot_observations=arguments.robot_observations)


def _report(
    data: MrclamSet, options: ConversionOptions, settings: Settings,
    rejected: Mapping[int, Counter[str]],
) -> Iterator[str]:
    yield f'landmarks: {len(data.landmarks)}, from {data.landmark_file or "no file"}'
    yield from _counted(Counter({
        f'broken row in {name}': count for name, count in data.broken_rows.items()}))
    if not noise.is_measurable(data):
        what = 'delays and scale' if any(len(log.truth) for log in data.logs.values()) else (
            'delays, scale and noise')
        yield f'too few true poses to measure {what}: they are those of set 6, or given by options'
    elif (r := noise.turn_correlation(data, options)) < noise.MIN_TURN_CORRELATION:
        yield (
            f'true poses do not follow the commands, the correlation of turns is {r:.2f}: check'
            ' robots and clock of the ground truth, or remove it; by it, noise is too large')
    # A start from true poses is never exact.
    if not any(settings.anchor_sigma):
        yield (
            f'map begins where {settings.anchor} starts, which has no true pose in its first'
            ' five minutes, and is not in the frame of any ground truth')
    for robot in ROBOT_SUBJECTS:
        if robot in data.logs:
            yield from _robot_report(data.logs[robot], options, rejected[robot])
        else:
            yield (
                f'{robot_name(robot)} is left out: Robot{robot}_Odometry.dat is missing, or has no'
                ' two valid rows')
            yield from _counted(data.incomplete[robot])


def _robot_report(
    log: RobotLog, options: ConversionOptions, rejected: Counter[str]
) -> Iterator[str]:
    used = len(log.observations) - rejected.total()
    true = len(conversion.truth(log, options))
    steps = np.diff(log.commands.stamps) / NS
    yield (
        f'{robot_name(log.robot)}: odometry: {len(log.commands)} (gaps above {REPORTED_GAP:g} s:'
        f' {(steps > REPORTED_GAP).sum()}, longest {steps.max():.1f} s),'
        f' observations: {used}, true poses: {true} of {len(log.truth)}')
    share = steps[steps > MAX_COMMAND_HOLD / NS].sum() / steps.sum()
    if share > REPORTED_UNKNOWN_SHARE:
        yield (
            f'    for {share:.0%} of the time the last command is older than'
            f' {MAX_COMMAND_HOLD / NS:g} s, and the motion unknown: repeat commands that were'
            ' recorded on change only')
    yield from _wrong_rows(log, true)
    yield from _lost_decimals(log)
    yield from _counted(log.counts + rejected)


def _wrong_rows(log: RobotLog, true: int) -> Iterator[str]:
    """Yield why most rows of a file are not used; `true` is the number of true poses that are."""
    if not len(log.observations):
        yield (
            f'    Robot{log.robot}_Measurement.dat is missing, or has no row that can be used:'
            ' this robot joins only as others observe it')
    if len(log.truth) and not true:
        before = (log.truth.stamps[0] - log.commands.stamps[0]) / NS
        yield (
            '    no true pose is of the time of the odometry: they begin'
            f' {abs(before):.0f} s {"after" if before > 0 else "before"} it; correct their times')
    if 2 * log.counts[UNKNOWN_CODE] > log.counts[UNKNOWN_CODE] + len(log.observations):
        yield (
            '    most observations have a bar code that is not in Barcodes.dat, whose columns are'
            ' subject and bar code')


def _lost_decimals(log: RobotLog) -> Iterator[str]:
    commands, observed = log.commands.stamps, log.observations.stamps
    in_whole_seconds = len(observed) >= MIN_WHOLE_SECONDS and not (observed % NS).any()
    if log.counts[REPLACED_COMMAND] > len(commands):
        yield (
            '    most commands have the stamp of another, and only the last one at each is used:'
            ' export times with all their decimals')
    elif in_whole_seconds and (commands % NS).any():
        yield (
            '    stamps of observations are whole seconds, those of commands are not: if their'
            ' decimals were lost, observations are wrong by the motion in a second')


def _clock_faults(
    data: MrclamSet, options: ConversionOptions, arguments: Namespace
) -> Iterator[str]:
    if not noise.is_measurable(data):
        return
    for what, given, delay, limit in (
            ('motion', arguments.motion_delay, options.motion_delay, MAX_MOTION_DELAY),
            ('camera', arguments.camera_delay, options.camera_delay, MAX_CAMERA_DELAY)):
        if given is None and abs(delay) > limit - END_OF_SEARCH:
            yield (
                f'the measured {what} delay, {delay:.1f} s, is the longest that is searched for:'
                ' check the clocks of ground truth, commands and observations')
    for robot, offset in camera_errors.clock_offsets(data, options.camera_delay).items():
        yield (
            f'observations of {robot_name(robot)} fit its true poses better if they are'
            f' {abs(offset):.1f} s {"earlier" if offset > 0 else "later"}: correct its clock, or'
            ' that of its ground truth')


def _counted(counts: Counter[str]) -> Iterator[str]:
    return (f'    {reason}: {count}' for reason, count in counts.items() if count)
