# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The table that ends a run."""

from collections.abc import Mapping, Sequence
from typing import Any

from fej_slam_ros.tables import text_table

HEADINGS = ('robot', 'frame', 'steps', 'RMSE [m]', 'RMSE [rad]', 'NEES/3', 'in', 'used', 'refused')


def run_table(summary: Mapping[str, Any]) -> str:
    """Return a summary as text: a row for each robot, then the map and what was refused."""
    lines = [format_table([HEADINGS, *(_row(n, summary) for n in summary['robots'] if n)])]
    landmarks = f'{summary["landmarks"]} landmarks in map'
    if 'landmarks' in summary.get('rmse', {}):
        landmarks += (
            f', RMSE {summary["rmse"]["landmarks"]:.3f} m,'
            f' NEES/2 {summary["nees"]["landmarks"]:.2f}')
    lines += ['', landmarks]
    rejected = {
        name: count for name, count in summary['counts'].items()
        if count and name not in ('used', 'released_without')}
    told = ', '.join(f'{name} {count}' for name, count in rejected.items())
    lines.append(f'refused: {told or "nothing"}')
    lines += [f'{name} is not in map: {why}' for name, why in summary['not_in_map'].items()]
    if summary['depends_on_arrival']:
        lines.append('the result depended on the order of arrival')
    return '\n'.join([*lines, f'state hash {summary["state_hash"]}'])


def format_table(rows: Sequence[Sequence[str]]) -> str:
    """Return a table of rows, the first of which is the head."""
    return text_table(rows[0], rows[1:])


def _row(name: str, summary: Mapping[str, Any]) -> tuple[str, ...]:
    robot = summary['robots'][name]
    rmse = summary.get('rmse', {}).get(name)
    nees = summary.get('nees', {}).get(name)
    return (
        name, robot['frame'], str(robot['steps']),
        '-' if rmse is None else f'{rmse["position"]:.3f}',
        '-' if rmse is None else f'{rmse["heading"]:.4f}',
        '-' if nees is None else f'{nees:.2f}',
        str(robot['received']), str(robot['used']), str(robot['refused']))
