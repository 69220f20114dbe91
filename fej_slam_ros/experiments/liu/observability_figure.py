# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Singular values of the observability matrix M of each filter."""

from collections.abc import Sequence
from itertools import groupby
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
import numpy as np

from fej_slam_ros.core.ekf.observability import RANK_TOLERANCE
from fej_slam_ros.experiments.common.drawing import TRUTH_COLOUR
from fej_slam_ros.experiments.liu.observability import Observability
from fej_slam_ros.figure_files import save
from fej_slam_ros.palette import ROBOT_COLOURS

#: Lower end of the plot: smaller singular values, zero included, are drawn here.
PLOT_FLOOR = 1e-18
#: Number of rigid motions of the whole team; all are unobservable.
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
        robots_seen = '\nrobots observed, too' if case[0].robots_seen else ''
        row[0].set_ylabel(f'N = {case[0].robots}, n = {case[0].landmarks}{robots_seen}')
    for axes in rows[-1]:
        axes.set_xlabel('index of the singular value')
    steps = results[0].windows[-1].m + 1
    figure.suptitle(
        f'Singular values of the observability matrix M of N robots and n landmarks over {steps}'
        ' steps, largest = 1')
    save(file, figure, rows[0][0], 4)


def _draw_filter(axes: Axes, result: Observability) -> None:
    window = result.windows[-1]
    values = np.maximum(window.singular_values, PLOT_FLOOR)
    indices = np.arange(1, len(values) + 1)
    observable = result.unknowns - RIGID_MOTIONS
    for begin, end, style, colour, label in (
        (0, observable, 'o', ROBOT_COLOURS[0], 'observable: 3N + 2n - 3 directions'),
        (observable, window.rank, 'D', ROBOT_COLOURS[1], 'spurious: heading of the whole team'),
        (window.rank, result.unknowns, 'x', TRUTH_COLOUR, 'zero: unobservable'),
    ):
        axes.semilogy(
            indices[begin:end], values[begin:end], style, color=colour, markersize=5, label=label)
    axes.axhline(
        RANK_TOLERANCE, color='black', linewidth=0.8, linestyle='--',
        label='threshold of the rank')
    axes.set(
        title=f'{result.filter}: rank {window.rank} of {result.unknowns}',
        ylim=(PLOT_FLOOR / 10, 10.0))
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.grid(alpha=0.25)
