# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures 2 to 5 of [Liu]: the simulated worlds, and the filters' errors over time in them."""

from collections.abc import Mapping
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator
import numpy as np

from fej_slam_ros.experiments.liu.configurations import Configuration
from fej_slam_ros.experiments.liu.metrics import Course, courses, nees_band
from fej_slam_ros.experiments.liu.monte_carlo import Errors
from fej_slam_ros.sim.world import World

#: Colour of a robot and the marker of its positions.
ROBOTS = (('#1f5fbf', 'o'), ('#c8501e', 's'))
#: Label, colour and line of each filter.
FILTERS = {
    'std': ('standard EKF', '#c8501e', '-'),
    'ideal': ('ideal EKF', '#555555', '--'),
    'fej': ('FEJ-EKF', '#1f5fbf', '-'),
}
ROWS = ('NEES / 3', 'position RMSE [m]', 'heading RMSE [rad]')


def draw_worlds(file: BinaryIO, worlds: Mapping[Configuration, World]) -> None:
    """Draw the first loop and the landmarks of the worlds of an environment, side by side."""
    figure = Figure(figsize=(5.0 * len(worlds), 5.6), layout='constrained')
    row = figure.subplots(1, len(worlds), squeeze=False)[0]
    for axes, (configuration, world) in zip(row, worlds.items()):
        steps = configuration.simulated.world.steps_per_loop
        for (robot, poses), (colour, marker) in zip(world.true_poses.items(), ROBOTS):
            _draw_poses(axes, robot, poses[:steps + 1], colour, marker)
        axes.plot(
            *np.array(list(world.landmarks.values())).T, '^', color='black', markersize=5,
            label='landmark')
        axes.set(
            title=f'{configuration.landmarks} landmarks', xlabel='x [m]', ylabel='y [m]',
            aspect='equal', adjustable='datalim')
        axes.grid(alpha=0.25)
    figure.suptitle(f'Environment {configuration.environment}: what is true')
    figure.legend(*row[0].get_legend_handles_labels(), loc='outside lower center', ncols=3)
    figure.savefig(file, dpi=110)


def _draw_poses(axes: Axes, robot: str, poses: np.ndarray, colour: str, marker: str) -> None:
    x, y, phi = poses.T
    axes.plot(
        x, y, marker, color=colour, markersize=5, fillstyle='none', label=f'{robot}, first loop')
    axes.quiver(
        x, y, np.cos(phi), np.sin(phi), color=colour, angles='xy', scale=30.0, width=0.003)


def draw_courses(
    file: BinaryIO, configuration: Configuration, by_filter: Mapping[str, Errors]
) -> None:
    """Draw NEES and RMSE over the steps for each robot (columns) and filter (lines)."""
    drawn = {name: courses(errors) for name, errors in by_filter.items()}
    runs = len(next(iter(by_filter.values())).landmarks)
    loop = configuration.simulated.world.steps_per_loop
    last = loop * configuration.simulated.world.loops
    robots = list(next(iter(drawn.values())))
    figure = Figure(figsize=(11.0, 8.5), layout='constrained')
    grid = figure.subplots(len(ROWS), len(robots), sharex=True, sharey='row')
    for column, robot in zip(grid.T, robots):
        for name, of_robots in drawn.items():
            _draw_course(column, name, of_robots[robot], last)
        column[0].axhspan(
            *nees_band(runs), color='#2a8a3e', alpha=0.3, label='95 % of consistent filters')
        column[0].set_title(robot)
        scale_by_logarithm(column[0])
        for axes in column:
            axes.axvline(
                loop, color='black', linewidth=0.8, linestyle=':', label='first loop closure')
            axes.grid(alpha=0.25)
        column[-1].set_xlabel('step')
    for axes, title in zip(grid[:, 0], ROWS):
        axes.set_ylabel(title)
    environment, landmarks = configuration
    figure.suptitle(f'Environment {environment}, {landmarks} landmarks, {runs} runs')
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=5)
    figure.savefig(file, dpi=110)


def scale_by_logarithm(axes: Axes) -> None:
    """Let y go by its logarithm, with ticks that can be read."""
    axes.set_yscale('log')
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_minor_locator(NullLocator())


def _draw_course(column: np.ndarray, name: str, course: Course, last: int) -> None:
    label, colour, line = FILTERS[name]
    steps = np.arange(last + 1 - len(course.nees), last + 1)
    for axes, values in zip(column, (course.nees, course.position, course.heading)):
        axes.plot(steps, values, line, color=colour, linewidth=1.1, label=label)
