# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The runs on MRCLAM sets as a page and as JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fej_slam_ros.experiments.real_data.causal_least_squares import CausalErrors
from fej_slam_ros.experiments.real_data.mrclam import MrclamRun, MrclamTask
from fej_slam_ros.tables import markdown_table

CAUSAL_NOTES = """\
The newest pose of each robot once a minute: of least squares over all until then, which is what a
filter can reach with the same measurements and noise, and of `fej` at the same stamps."""
CAUSAL_TITLES = (
    'set', 'robot-to-robot observations', 'poses', 'least squares [m]', 'fej [m]')
MRCLAM_NOTES = """\
Robots run from the commands, scaled, delayed and with the noise that `convert mrclam` measures;
all but the anchor have unknown starts. Position and heading errors are root mean squares over all
true poses of all robots, as estimated (in the frame of the anchor's given start) and after one
rigid fit of all robots; NEES/3 and NIS/2 are means. Landmarks are compared after the same fit.
Robots without ground truth take part and are not evaluated. Least squares is that of `smooth`; it
knows the later measurements too. Dead reckoning starts each robot at its true pose."""
MRCLAM_TITLES = (
    'set', 'filter', 'robot-to-robot observations', 'position [m]', 'after a fit [m]',
    'worst robot [m]', 'heading [rad]', 'after a fit [rad]', 'NEES/3', 'NIS/2', 'landmarks',
    'landmarks [m]', 'in map, least [%]', 'time [s]')


def markdown(runs: Sequence[MrclamRun]) -> str:
    """Return the runs as a page."""
    first_of_set = {result.task.name: result for result in reversed(runs)}
    drifts = [
        f'{name}: {", ".join(f"{robot} {e:.2f}" for robot, e in result.dead_reckoning.items())}'
        for name, result in sorted(first_of_set.items()) if result.dead_reckoning]
    return '\n\n'.join([
        '# MRCLAM', MRCLAM_NOTES, markdown_table(MRCLAM_TITLES, map(_row, runs), (0, 1, 2)),
        CAUSAL_NOTES, markdown_table(CAUSAL_TITLES, [
            _causal_row(result.task, result.causal) for result in runs
            if result.causal and result.causal.poses],
            (0, 1)),
        f'Dead reckoning, position RMSE [m]: {"; ".join(drifts)}.']) + '\n'


def summary(runs: Sequence[MrclamRun]) -> list[dict[str, Any]]:
    """Return the runs for a JSON file."""
    return [asdict(result) | {'task': {
        'set': result.task.name, 'filter': result.task.filter,
        'robots_seen': result.task.robots_seen}}
        for result in runs]


def _row(result: MrclamRun) -> list[str]:
    return [
        result.task.name, result.task.filter, 'used' if result.task.robots_seen else 'not used',
        f'{result.position:.3f}', f'{result.fitted_position:.3f}',
        f'{max(result.of_robots.values()):.3f}',
        f'{result.heading:.4f}', f'{result.fitted_heading:.4f}', f'{result.nees:.2f}',
        '' if result.nis is None else f'{result.nis:.2f}',
        f'{result.landmarks} of {result.true_landmarks}', f'{result.landmark_rmse:.3f}',
        f'{100.0 * min(result.in_map.values()):.1f}', f'{result.seconds:.0f}']


def _causal_row(task: MrclamTask, causal: CausalErrors) -> list[str]:
    return [
        task.name, 'used' if task.robots_seen else 'not used', str(causal.poses),
        f'{causal.least_squares:.3f}', f'{causal.filter:.3f}']
