# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figure 6 of [Liu]: Victoria Park by least squares and by the filters."""

from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from fej_slam_ros.experiments.liu.victoria_park import (
    OBSERVATION_SIGMAS, PARK_FILTERS, ParkEstimate, VictoriaPark)
from fej_slam_ros.figure_files import save
from fej_slam_ros.palette import ROBOT_COLOURS

ROBOT_LINES = {'r1': ('-', ROBOT_COLOURS[0]), 'r2': ('--', ROBOT_COLOURS[1])}


def draw(file: BinaryIO, result: VictoriaPark) -> None:
    """Draw least squares over both robots and the filters, side by side, as a PNG."""
    figure = Figure(figsize=(5.0 * (1 + len(PARK_FILTERS)), 5.4), layout='constrained')
    panels = figure.subplots(1, 1 + len(PARK_FILTERS), sharex=True, sharey=True)
    _draw_estimate(panels[0], 'Gauss-Newton over both robots', result.two_robots.estimate)
    for axes, (name, title) in zip(panels[1:], PARK_FILTERS.items()):
        e = result.rmse[OBSERVATION_SIGMAS[0]]['two_robot_batch'][name]
        rmse = f'RMSE R1 {e["r1_pos"]:.2f} m, R2 {e["r2_pos"]:.2f} m, map {e["f_pos"]:.2f} m'
        _draw_estimate(axes, f'{title} filter: {rmse}', result.filters[name])
    figure.suptitle('Victoria Park, two robots: RMSE against Gauss-Newton')
    panels[0].set_ylabel('y [m]')
    save(file, figure, panels[0], 3)


def _draw_estimate(axes: Axes, title: str, estimate: ParkEstimate) -> None:
    axes.plot(
        *np.array(list(estimate.points.values())).T, '^', markersize=4.5, fillstyle='none',
        color='black', markeredgewidth=0.7, label='landmark')
    for robot, poses in estimate.poses.items():
        line, colour = ROBOT_LINES[robot]
        axes.plot(*poses[:, :2].T, line, color=colour, linewidth=1.2, label=robot.upper())
    axes.set_title(title, fontsize='medium')
    axes.set(xlabel='x [m]', aspect='equal')
    axes.grid(alpha=0.25)
