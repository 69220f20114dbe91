# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The errors of an MRCLAM set's commands and camera as text."""

from collections.abc import Iterable
from dataclasses import replace

from fej_slam_ros.cli.run_table import format_table
from fej_slam_ros.datasets.mrclam import noise
from fej_slam_ros.datasets.mrclam.conversion import Reading, robot_name
from fej_slam_ros.datasets.mrclam.files import DataSet

#: Windows [s] over which speeds are averaged.
WINDOWS = (0.2, 1.0, 5.0)


def noise_tables(data: DataSet, how: Reading) -> str:
    """Return the errors of commands and camera as text."""
    tables = [_setting_table(how), _speed_table(data, how), _observation_table(data)]
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
        errors = [noise.increments(some, how, window).errors() for window in WINDOWS]
        if all(map(len, errors)):
            sds = [e.std(axis=0) / window for e, window in zip(errors, WINDOWS)]
            yield (who, *(f'{sd[axis]:.3f}' for axis in (0, 2) for sd in sds))


def _observation_table(data: DataSet) -> Iterable[tuple[str, ...]]:
    kinds = dict(zip(('of landmarks', 'of robots'), noise.observation_errors(data)))
    here = {kind: errors for kind, errors in kinds.items() if not errors.gross().all()}
    found = [noise.observation_noise(errors) for errors in here.values()]
    yield ('observations', *here)
    yield ('count', *(str(noise.count) for noise in found))
    yield ('gross [%]', *(f'{100 * noise.gross / noise.count:.2f}' for noise in found))
    for what, form, field in (
        ('range sd [m]', '.3f', 'range_sd'), ('range mean [m]', '.3f', 'range_mean'),
        ('range rms per metre', '.4f', 'range_growth'), ('bearing sd [rad]', '.4f', 'bearing_sd'),
        ('bearing mean [rad]', '.4f', 'bearing_mean'), ('bearing rms [rad]', '.4f', 'bearing_rms'),
    ):
        yield (what, *(format(getattr(noise, field), form) for noise in found))
    for low, high in noise.LAGS:
        yield (
            f'correlation of range errors {low:g} to {high:g} s apart',
            *(f'{noise.correlation[low, high]:.2f}' for noise in found))
