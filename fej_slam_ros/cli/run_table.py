# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Table that `replay`, `smooth` and `demo` print at the end of a run."""

from collections.abc import Mapping
from typing import Any

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.tables import number, text_table

RUN_HEADINGS = (
    'robot', 'frame', 'steps', 'RMSE [m]', 'RMSE [rad]', 'NEES/3', 'messages', 'used',
    'rejected')
#: NEES/3 that all robots exceed, and NIS per degree of freedom that none does, where the ground
#: truth is in another frame. An overconfident filter has up to 60 and 1.
OTHER_FRAME_NEES, CONSISTENT_NIS = 100.0, 2.0


def run_table(summary: Mapping[str, Any]) -> str:
    """Return a summary as text: a row per robot, the map, rejections, robots outside the map."""
    unknown = {
        name: robot['received'] for name, robot in summary['robots'].items()
        if 0 < robot['received'] == robot['refusals'].get(RejectionReason.UNKNOWN_ROBOT.value)}
    lines = [text_table(RUN_HEADINGS, (
        _row(name, summary) for name in summary['robots'] if name and name not in unknown))]
    landmarks = f'{summary["landmarks"]} landmarks in map'
    if 'landmarks' in summary.get('rmse', {}):
        landmarks += (
            f', RMSE {summary["rmse"]["landmarks"]:.3f} m,'
            f' NEES/2 {summary["nees"]["landmarks"]:.2f}')
    rejected = {
        reason: count for reason, count in summary['counts'].items()
        if count and reason not in ('used', 'released_without')}
    in_words = ', '.join(f'{reason} {count}' for reason, count in rejected.items())
    lines += ['', landmarks]
    if _is_truth_in_another_frame(summary):
        lines.append(
            'the ground truth is probably in another frame than map, as NEES is large and NIS is'
            ' not: evaluate gives the errors after alignment')
    lines += [f'rejected messages and single observations: {in_words or "none"}']
    if sum(rejected.values()) > sum(r['sightings_used'] for r in summary['robots'].values()):
        lines.append('more is rejected than observations are used: doctor names causes and cures')
    lines += [
        f'{name} is not in robots: its {count} messages are rejected'
        for name, count in unknown.items() if name]
    lines += [f'{name} is not in map: {why}' for name, why in summary['not_in_map'].items()]
    if summary['depends_on_arrival']:
        lines.append('the result depends on the order of arrival')
    return '\n'.join([*lines, f'state hash {summary["state_hash"]}'])


def _is_truth_in_another_frame(summary: Mapping[str, Any]) -> bool:
    nees = [summary.get('nees', {}).get(name) for name in summary['robots']]
    of_robots = [value for value in nees if value is not None]
    nis = [robot['per_dof'] for robot in summary.get('nis', {}).values()]
    return bool(of_robots and nis) and (
        min(of_robots) > OTHER_FRAME_NEES and max(nis) < CONSISTENT_NIS)


def _row(name: str, summary: Mapping[str, Any]) -> tuple[str, ...]:
    robot = summary['robots'][name]
    rmse = summary.get('rmse', {}).get(name, {})
    return (
        name, robot['frame'], str(robot['steps']), number(rmse.get('position'), '.3f'),
        number(rmse.get('heading'), '.4f'), number(summary.get('nees', {}).get(name), '.2f'),
        str(robot['received']), str(robot['used']), str(robot['refused']))


def matched_in_words(counts: Mapping[str, int]) -> str:
    """Return the numbers of observations without ID that were matched, new or doubtful as text."""
    return (
        '{matched} observations without ID matched landmarks, {new} began some, {doubtful} may be'
        ' of several and were left out'.format_map(counts))
