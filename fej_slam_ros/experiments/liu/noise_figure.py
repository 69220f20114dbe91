# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""NEES and RMSE of the filters over levels of noise."""

from collections.abc import Mapping
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from fej_slam_ros.experiments.liu import figures
from fej_slam_ros.experiments.liu.metrics import Mean
from fej_slam_ros.experiments.liu.noise import Case, Means

#: Label, colour and line of each filter, as in the paper's figures, and its marker: colours that
#: nobody takes for each other, whichever they see.
FILTERS = {
    'standard': (*figures.FILTERS['std'], 's'),
    'fej': (*figures.FILTERS['fej'], 'o'),
    'ideal': (*figures.FILTERS['ideal'], 'x'),
    'invariant': ('invariant EKF', '#56b4e9', '-', 'D'),
}
#: How far filters stand apart at a level, so that their intervals do not cover each other.
APART = 0.09
QUANTITIES = ('nees', 'pos', 'head')
#: Linearising at the truth may diverge: so many times above the other filters it leaves the panel.
CROP = 3.0


def draw(file: BinaryIO, means: Means) -> None:
    """Draw a column for each experiment and robot, with 95 % confidence intervals, as a PNG."""
    columns = [
        (configuration, robot)
        for configuration in dict.fromkeys(case.configuration for case in means)
        for robot in ('r1', 'r2')]
    figure = Figure(figsize=(4.2 * len(columns), 9.0), layout='constrained')
    grid = figure.subplots(len(QUANTITIES), len(columns), sharex='col', sharey='row')
    for column, (configuration, robot) in zip(grid.T, columns):
        of_it = {case: rows for case, rows in means.items() if case.configuration == configuration}
        for axes, quantity in zip(column, QUANTITIES):
            _draw_panel(axes, f'{robot}_{quantity}', of_it)
        column[0].set_title(f'environment {configuration.environment}, {robot.upper()}')
        column[0].axhline(1.0, color='black', linewidth=0.8, linestyle=':', label='consistent')
        column[-1].set_xlabel('odometry of a step; observations')
    for axes, label, quantity in zip(grid[:, 0], figures.ROWS, QUANTITIES):
        axes.set_ylabel(label)
        highest = max(
            rows[name][f'{robot}_{quantity}'].value for rows in means.values()
            for name in FILTERS.keys() - {'ideal'} for robot in ('r1', 'r2'))
        axes.set_ylim(top=min(axes.get_ylim()[1], CROP * highest))
    figure.suptitle('The filters over levels of noise: means over runs, 95 % confidence intervals')
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=5)
    figure.savefig(file, dpi=110)


def _draw_panel(
    axes: Axes, entry: str, of_cases: Mapping[Case, Mapping[str, Mapping[str, Mean]]]
) -> None:
    levels = np.arange(len(of_cases))
    for k, (name, (label, colour, line, marker)) in enumerate(FILTERS.items()):
        of_filter = [rows[name][entry] for rows in of_cases.values()]
        axes.errorbar(
            levels + APART * (k - 1.5), [mean.value for mean in of_filter],
            [mean.margin or 0.0 for mean in of_filter], color=colour, linestyle=line,
            linewidth=1.0, marker=marker, markersize=5, capsize=3, label=label)
    figures.scale_by_logarithm(axes)
    axes.set_xticks(levels, [_label(case) for case in of_cases], fontsize='small')
    axes.grid(alpha=0.25)


def _label(case: Case) -> str:
    position, heading, observation = case.sigmas
    return f'{position:g} m\n{heading:g} deg\n{observation:g} m'
