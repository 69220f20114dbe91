# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The singular values of M: what a filter believes that it can know, and what it leaves open."""

from collections.abc import Sequence
from itertools import groupby
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np

from fej_slam_ros.core.ekf.observability import RANK_TOLERANCE
from fej_slam_ros.experiments.common.scene import TRUTH
from fej_slam_ros.experiments.liu.observability import Observability
from fej_slam_ros.palette import ROBOT_COLOURS

#: Smaller singular values are drawn here, exact zeros too.
FLOOR = 1e-18

#: No observation tells of so many rigid motions of everything.
RIGID_MOTIONS = 3


def draw(file: BinaryIO, results: Sequence[Observability]) -> None:
    """Draw M over all steps as a PNG, a row for each case and the filters side by side."""
    cases = [
        list(case)
        for _, case in groupby(results, lambda r: (r.robots, r.landmarks, r.robots_seen))]
    size = (3.0 * len(cases[0]) + 0.8, 2.7 * len(cases) + 1.0)
    figure = Figure(figsize=size, layout='constrained')
    rows = figure.subplots(len(cases), len(cases[0]), squeeze=False, sharex='row', sharey=True)
    for case, row in zip(cases, rows):
        for result, axes in zip(case, row):
            _draw_filter(axes, result)
        robots_seen = '\nrobots seen, too' if case[0].robots_seen else ''
        row[0].set_ylabel(f'N = {case[0].robots}, n = {case[0].landmarks}{robots_seen}')
    for axes in rows[-1]:
        axes.set_xlabel('number of the singular value')
    steps = results[0].windows[-1].m + 1
    figure.suptitle(
        f'Singular values of the observability matrix M of N robots and n landmarks over {steps}'
        ' steps, largest = 1')
    handles, labels = rows[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='outside lower center', ncols=2, fontsize='small')
    figure.savefig(file, dpi=110)


def _draw_filter(axes: Axes, result: Observability) -> None:
    window = result.windows[-1]
    values = np.maximum(window.singular_values, FLOOR)
    numbers = np.arange(1, len(values) + 1)
    observable = result.unknowns - RIGID_MOTIONS
    for begin, end, style, colour, label in (
        (0, observable, 'o', ROBOT_COLOURS[0], 'observable: 3N + 2n - 3 directions'),
        (observable, window.rank, 'D', ROBOT_COLOURS[1], 'spurious: the heading of the whole team'),
        (window.rank, result.unknowns, 'x', TRUTH, 'zero: stays unknown'),
    ):
        axes.semilogy(
            numbers[begin:end], values[begin:end], style, color=colour, markersize=5, label=label)
    axes.axhline(
        RANK_TOLERANCE, color='black', linewidth=0.8, linestyle='--', label='1e-8: above it counts')
    axes.set(
        title=f'{result.filter}: rank {window.rank} of {result.unknowns}', ylim=(FLOOR / 10, 10.0))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.25)
