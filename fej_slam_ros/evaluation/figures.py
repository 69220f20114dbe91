# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of a run beside the truth: the ways and the map, errors over time, and NEES."""

from collections.abc import Iterator
import math
from typing import BinaryIO

from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
import numpy as np
from scipy.special import chdtr

from fej_slam_ros.core.chi_square import chi_square_band
from fej_slam_ros.core.geometry import Array, ellipse, wrap_all
from fej_slam_ros.core.records import NS
from fej_slam_ros.evaluation.run_evaluation import RunEvaluation
from fej_slam_ros.palette import robot_colour, ROBOTS

#: What tells robots apart that have the same colour.
LINES = ('-', '--', ':', '-.')
SIGMAS = 3.0
#: So many ellipses are drawn along the way of a robot.
ELLIPSES = 8


def draw_ways(file: BinaryIO, judged: RunEvaluation) -> None:
    """Draw ways and landmarks as estimated, with 3-sigma ellipses, over the truth."""
    figure = Figure(figsize=(9.0, 8.0), layout='constrained')
    axes = figure.subplots()
    in_map = {name: of for name, of in judged.compared.items() if of.in_map}
    for k, (name, of) in enumerate(in_map.items()):
        colour, line = _style(k)
        axes.plot(
            *of.true[:, :2].T, color='black', linewidth=0.9, zorder=1,
            label=None if k else 'true way')
        axes.plot(*of.poses[:, :2].T, line, color=colour, linewidth=1.6, label=name, zorder=3)
        axes.plot(*of.poses[0, :2], 'o', color=colour, markersize=6, zorder=4)
        for j in np.linspace(0, len(of.stamps) - 1, min(ELLIPSES, len(of.stamps)), dtype=int):
            axes.add_patch(_ellipse(of.poses[j, :2], of.P[j, :2, :2], colour))
    told = judged.outcome.landmarks
    grey = '#666666'
    if len(told.ids):
        axes.plot(
            *told.points.T, '+', color=grey, markersize=7, label='landmark, estimated', zorder=4)
    for point, P in zip(told.points, told.P):
        axes.add_patch(_ellipse(point, P, grey))
    true = np.array([*judged.truth.landmarks.values()]).reshape(-1, 2)
    if len(true):
        axes.plot(
            *true.T, '^', color='black', fillstyle='none', markersize=6, label='landmark, true')
    axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', adjustable='datalim')
    axes.set_title('As estimated, in map; ellipses are 3 sigma, dots where robots begin')
    axes.grid(alpha=0.25)
    figure.legend(*axes.get_legend_handles_labels(), loc='outside lower center', ncols=5)
    figure.savefig(file, dpi=110)


def draw_errors(file: BinaryIO, judged: RunEvaluation) -> None:
    """Draw the errors of each robot over time, with 3 sigma as it claims them."""
    in_map = {name: of for name, of in judged.compared.items() if of.in_map}
    figure = Figure(figsize=(11.0, 1.2 + 2.3 * max(len(in_map), 1)), layout='constrained')
    grid = figure.subplots(max(len(in_map), 1), 3, sharex=True, squeeze=False)
    begin = _begin(judged)
    for row, (name, of) in zip(grid, in_map.items()):
        errors = of.poses - of.true
        errors[:, 2] = wrap_all(errors[:, 2])
        for axis, (axes, unit) in enumerate(zip(row, ('x [m]', 'y [m]', 'heading [rad]'))):
            seconds = (of.stamps - begin) / NS
            sigma = SIGMAS * np.sqrt(np.maximum(of.P[:, axis, axis], 0.0))
            axes.fill_between(
                seconds, -sigma, sigma, color='#56b4e9', alpha=0.35, linewidth=0.0,
                label='3 sigma, claimed')
            axes.plot(seconds, errors[:, axis], color='black', linewidth=1.0, label='error')
            axes.set_ylabel(f'{name}: {unit}')
            axes.grid(alpha=0.25)
    for axes in grid[-1]:
        axes.set_xlabel('time [s]')
    figure.suptitle('Estimate - truth, without alignment')
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc='outside lower center', ncols=2)
    figure.savefig(file, dpi=110)


def draw_nees(file: BinaryIO, judged: RunEvaluation) -> None:
    """Draw NEES / 3 of each robot over time, and which part of its errors lies how far in."""
    figure = Figure(figsize=(11.0, 5.0), layout='constrained')
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    low, high = (bound / 3.0 for bound in chi_square_band(3, 0.95))
    left.axhspan(low, high, color='#009e73', alpha=0.2, label='95 % of single consistent poses')
    left.axhline(1.0, color='black', linewidth=0.8, linestyle=':', label='consistent')
    p = np.linspace(0.0, 1.0, 101)
    right.plot(p, p, color='black', linewidth=0.8, linestyle=':')
    begin = _begin(judged)
    for k, (name, ratings) in enumerate(_rated(judged)):
        colour, line = _style(k)
        of = judged.compared[name]
        left.plot(
            (of.stamps - begin) / NS, ratings, line, color=colour, linewidth=1.1, label=name)
        inside = np.sort(chdtr(3, 3.0 * ratings[np.isfinite(ratings)]))
        right.plot(
            [0.0, *inside, 1.0], [0.0, *np.arange(1, len(inside) + 1) / len(inside), 1.0], line,
            color=colour, linewidth=1.5)
    left.set_yscale('log')
    left.set_ylim(bottom=max(left.get_ylim()[0], 1e-3))
    left.yaxis.set_major_formatter('{x:g}')
    left.set(xlabel='time [s]', ylabel='NEES / 3', title='NEES: above 1 is overconfident')
    right.set(
        xlabel='probability of the region', ylabel='part of the errors inside',
        title='Coverage: below the diagonal is overconfident', aspect='equal')
    for axes in (left, right):
        axes.grid(alpha=0.25)
    figure.legend(*left.get_legend_handles_labels(), loc='outside lower center', ncols=5)
    figure.savefig(file, dpi=110)


def _rated(judged: RunEvaluation) -> Iterator[tuple[str, Array]]:
    for name, ratings in judged.ratings.items():
        if np.isfinite(ratings).any():
            yield name, ratings


def _begin(judged: RunEvaluation) -> int:
    return min(int(of.stamps[0]) for of in judged.compared.values())


def _style(k: int) -> tuple[str, str]:
    return robot_colour(k), LINES[k // len(ROBOTS) % len(LINES)]


def _ellipse(at: Array, P: Array, colour: str) -> Ellipse:
    major, minor, angle = ellipse(P)
    return Ellipse(
        (at[0], at[1]), 2.0 * SIGMAS * major, 2.0 * SIGMAS * minor, angle=math.degrees(angle),
        facecolor=colour, edgecolor=colour, alpha=0.25, linewidth=1.0, zorder=2)
