# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measured noise of the odometry and camera of an MRCLAM set, as text tables."""

from collections.abc import Iterator
from dataclasses import replace

from fej_slam_ros.datasets.mrclam import command_errors, observation_errors
from fej_slam_ros.datasets.mrclam.conversion import robot_name
from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions
from fej_slam_ros.datasets.mrclam.files import MrclamSet
from fej_slam_ros.tables import text_table

#: Lengths of the windows of mean speeds [s]; the shortest is about the delay of a command.
SPEED_WINDOWS = (0.2, 1.0, 5.0)


def noise_tables(data: MrclamSet, options: ConversionOptions) -> str:
    """Return tables of odometry settings, speed errors and observation errors."""
    tables = (
        _settings_rows(options), _speed_rows(data, options), _camera_rows(options),
        _observation_rows(data, options))
    return '\n\n'.join(text_table(head, rows) for head, *rows in tables)


def _settings_rows(options: ConversionOptions) -> Iterator[tuple[str, ...]]:
    variances, delay = options.noise, f'{options.motion_delay:.2f}'
    yield 'commands', 'ahead', 'turning'
    yield 'delay [s]', delay, delay
    yield 'delay of cameras [s]', '', f'{options.camera_delay:.3f}'
    yield ('true over commanded speed', *(f'{scale:.3f}' for scale in options.odometry_scale))
    yield 'decrease of that per turn rate [s/rad]', f'{options.slowdown:.3f}', ''
    for robot, (per_metre, per_radian) in options.own_turns.items():
        yield (
            f'own turns of {robot_name(robot)} [rad/m, rad/rad]', f'{per_metre:+.3f}',
            f'{per_radian:+.3f}')
    for k, amount in enumerate(('metre driven', 'radian turned')):
        yield (
            f'variance per {amount} [m^2, rad^2]',
            f'{variances.position[k]:.5f}', f'{variances.heading[k]:.5f}')


def _speed_rows(data: MrclamSet, options: ConversionOptions) -> Iterator[tuple[str, ...]]:
    yield (
        'speed error sd',
        *(f'{unit} in {window:g} s' for unit in ('m/s', 'rad/s') for window in SPEED_WINDOWS))
    single = {robot_name(k): replace(data, logs={k: log}) for k, log in data.logs.items()}
    for name, part in {**single, 'all': data}.items():
        errors = [
            command_errors.increments(part, options, window).errors() for window in SPEED_WINDOWS]
        if all(map(len, errors)):
            sds = [e.std(axis=0) / window for e, window in zip(errors, SPEED_WINDOWS)]
            yield (name, *(f'{sd[axis]:.3f}' for axis in (0, 2) for sd in sds))


def _camera_rows(options: ConversionOptions) -> Iterator[tuple[str, ...]]:
    yield 'camera', 'range offset [m]', 'range error per metre', 'bearing offset [rad]'
    for robot, (bearing, _) in options.bearing_offsets.items():
        offset, per_metre = options.range_errors.get(robot, (0.0, 0.0))
        yield robot_name(robot), f'{offset:+.3f}', f'{per_metre:+.4f}', f'{bearing:+.4f}'


def _observation_rows(
    data: MrclamSet, options: ConversionOptions
) -> Iterator[tuple[str, ...]]:
    landmarks, robots = observation_errors.observation_errors(data)
    by_kind = {
        kind: observation_errors.error_statistics(errors)
        for kind, errors in (('of landmarks', landmarks), ('of robots', robots))
        if not errors.outliers().all()}
    measured = by_kind.values()
    yield ('observations', *by_kind)
    yield ('count', *(str(m.count) for m in measured))
    yield ('gross [%]', *(f'{100 * m.outliers / m.count:.2f}' for m in measured))
    for label, form, field in (
        ('range sd [m]', '.3f', 'range_sd'), ('range mean [m]', '.3f', 'range_mean'),
        ('range rms per metre', '.4f', 'relative_range_rms'),
        ('bearing sd [rad]', '.4f', 'bearing_sd'),
        ('bearing mean [rad]', '.4f', 'bearing_mean'), ('bearing rms [rad]', '.4f', 'bearing_rms'),
    ):
        yield (label, *(format(getattr(m, field), form) for m in measured))
    for low, high in observation_errors.LAGS:
        yield (
            f'correlation of range errors {low:g} to {high:g} s apart',
            *(f'{m.correlation[low, high]:.2f}' for m in measured))
    used = {'of landmarks': options.noise.landmarks, 'of robots': options.noise.robots}
    for field, label in (('range_constant', 'constant [m]'), ('range', 'per metre')):
        yield (
            f'range sd as used, {label}',
            *(f'{getattr(used[kind], field):.4f}' for kind in by_kind))
    factor = f'{options.correlation_factor:.2f}'
    yield ('factor for errors that persist', *(factor for _ in measured))
