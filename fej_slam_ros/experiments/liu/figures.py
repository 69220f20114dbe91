# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of [Liu]: the worlds and the errors over time in them (2 to 5), Victoria Park (6)."""

from collections.abc import Mapping
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.experiments.common.drawing import FILTER_STYLES, scale_by_logarithm
from fej_slam_ros.experiments.liu.configurations import Configuration, TABLE_FILTERS
from fej_slam_ros.experiments.liu.metrics import error_curves, ErrorCurves
from fej_slam_ros.experiments.liu.monte_carlo import Errors
from fej_slam_ros.experiments.liu.victoria_park import (
    OBSERVATION_SIGMAS, PARK_FILTERS, ParkEstimate, VictoriaPark)
from fej_slam_ros.figure_files import save
from fej_slam_ros.palette import ROBOT_COLOURS
from fej_slam_ros.sim.world import World

ROBOT_LINES = {'r1': ('-', ROBOT_COLOURS[0]), 'r2': ('--', ROBOT_COLOURS[1])}
#: Colour and marker of each robot's positions.
ROBOT_MARKERS = (('#1f5fbf', 'o'), ('#c8501e', 's'))
ERROR_LABELS = ('NEES / 3', 'position RMSE [m]', 'heading RMSE [rad]')


def draw_worlds(file: BinaryIO, worlds: Mapping[Configuration, World]) -> None:
    """Draw the first loop and the landmarks of the worlds of an environment, side by side."""
    figure = Figure(figsize=(5.0 * len(worlds), 5.6), layout='constrained')
    row = figure.subplots(1, len(worlds), squeeze=False)[0]
    for axes, (configuration, world) in zip(row, worlds.items()):
        steps = configuration.simulated.world.steps_per_loop
        for (robot, poses), (colour, marker) in zip(world.true_poses.items(), ROBOT_MARKERS):
            _draw_poses(axes, robot, poses[:steps + 1], colour, marker)
        axes.plot(
            *np.array(list(world.landmarks.values())).T, '^', color='black', markersize=5,
            label='landmark')
        axes.set(
            title=f'{configuration.landmarks} landmarks', xlabel='x [m]', ylabel='y [m]',
            aspect='equal', adjustable='datalim')
        axes.grid(alpha=0.25)
    figure.suptitle(f'Environment {configuration.environment}: ground truth')
    save(file, figure, row[0], 3)


def draw_park(file: BinaryIO, result: VictoriaPark) -> None:
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


def _draw_poses(axes: Axes, robot: str, poses: np.ndarray, colour: str, marker: str) -> None:
    x, y, phi = poses.T
    axes.plot(
        x, y, marker, color=colour, markersize=5, fillstyle='none', label=f'{robot}, first loop')
    axes.quiver(
        x, y, np.cos(phi), np.sin(phi), color=colour, angles='xy', scale=30.0, width=0.003)


def draw_errors(
    file: BinaryIO, configuration: Configuration, by_filter: Mapping[str, Errors]
) -> None:
    """Draw NEES and RMSE over the steps for each robot (columns) and filter (lines)."""
    curves = {name: error_curves(errors) for name, errors in by_filter.items()}
    runs = len(next(iter(by_filter.values())).landmarks)
    loop = configuration.simulated.world.steps_per_loop
    last = loop * configuration.simulated.world.loops
    robots = list(next(iter(curves.values())))
    figure = Figure(figsize=(11.0, 8.5), layout='constrained')
    grid = figure.subplots(len(ERROR_LABELS), len(robots), sharex=True, sharey='row')
    for column, robot in zip(grid.T, robots):
        for name, of_robots in curves.items():
            _draw_curves(column, TABLE_FILTERS[name], of_robots[robot], last)
        column[0].axhspan(
            *band_per_dof(3 * runs), color='#2a8a3e', alpha=0.3,
            label='95 % of consistent filters')
        column[0].set_title(robot)
        scale_by_logarithm(column[0])
        for axes in column:
            axes.axvline(
                loop, color='black', linewidth=0.8, linestyle=':', label='first loop closure')
            axes.grid(alpha=0.25)
        column[-1].set_xlabel('step')
    for axes, label in zip(grid[:, 0], ERROR_LABELS):
        axes.set_ylabel(label)
    environment, landmarks = configuration
    figure.suptitle(f'Environment {environment}, {landmarks} landmarks, {runs} runs')
    save(file, figure, grid[0, 0], 5)


def _draw_curves(column: np.ndarray, name: str, curves: ErrorCurves, last: int) -> None:
    style = FILTER_STYLES[name]
    steps = np.arange(last + 1 - len(curves.nees), last + 1)
    for axes, values in zip(column, (curves.nees, curves.position, curves.heading)):
        axes.plot(
            steps, values, style.line, color=style.colour, linewidth=1.1, label=style.label)


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
