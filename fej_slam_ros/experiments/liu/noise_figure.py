# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""NEES and RMSE of the filters at several levels of noise."""

from collections.abc import Mapping
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from fej_slam_ros.experiments.common.drawing import FILTER_STYLES, scale_by_logarithm
from fej_slam_ros.experiments.liu.figures import ERROR_LABELS
from fej_slam_ros.experiments.liu.noise import (
    by_configuration, CaseMeans, Means, NOISE_FILTERS, NoiseCase)
from fej_slam_ros.figure_files import save

#: Horizontal distance between the filters at a level, so that their intervals do not overlap.
FILTER_OFFSET = 0.09
QUANTITIES = ('nees', 'pos', 'head')
#: Linearisation at the truth may diverge: the panel ends at this multiple of the other filters.
CROP = 3.0


def draw(file: BinaryIO, means: Means) -> None:
    """Draw a column for each experiment and robot, with 95 % confidence intervals, as a PNG."""
    columns = [
        (configuration, cases, robot) for configuration, cases in by_configuration(means).items()
        for robot in ('r1', 'r2')]
    figure = Figure(figsize=(4.2 * len(columns), 9.0), layout='constrained')
    grid = figure.subplots(len(QUANTITIES), len(columns), sharex='col', sharey='row')
    for column, (configuration, cases, robot) in zip(grid.T, columns):
        for axes, quantity in zip(column, QUANTITIES):
            _draw_panel(axes, f'{robot}_{quantity}', cases)
        column[0].set_title(f'environment {configuration.environment}, {robot.upper()}')
        column[0].axhline(1.0, color='black', linewidth=0.8, linestyle=':', label='consistent')
        column[-1].set_xlabel('sigma of odometry per step; of observations')
    for axes, label, quantity in zip(grid[:, 0], ERROR_LABELS, QUANTITIES):
        axes.set_ylabel(label)
        highest = max(
            rows[name][f'{robot}_{quantity}'].value for rows in means.values()
            for name in NOISE_FILTERS if name != 'ideal' for robot in ('r1', 'r2'))
        axes.set_ylim(top=min(axes.get_ylim()[1], CROP * highest))
    figure.suptitle('Filters at several levels of noise: means over runs, 95 % confidence')
    save(file, figure, grid[0, 0], 5)


def _draw_panel(axes: Axes, entry: str, cases: Mapping[NoiseCase, CaseMeans]) -> None:
    levels = np.arange(len(cases))
    for k, name in enumerate(NOISE_FILTERS):
        style = FILTER_STYLES[name]
        means = [rows[name][entry] for rows in cases.values()]
        axes.errorbar(
            levels + FILTER_OFFSET * (k - 1.5), [mean.value for mean in means],
            [mean.margin or 0.0 for mean in means], color=style.colour, linestyle=style.line,
            linewidth=1.0, marker=style.marker, markersize=5, capsize=3, label=style.label)
    scale_by_logarithm(axes)
    axes.set_xticks(levels, [_label(case) for case in cases], fontsize='small')
    axes.grid(alpha=0.25)


def _label(case: NoiseCase) -> str:
    position, heading, observation = case.sigmas
    return f'{position:g} m\n{heading:g} deg\n{observation:g} m'
