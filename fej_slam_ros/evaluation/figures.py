# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of a run and its ground truth: trajectories and map, errors over time, and NEES."""

import math
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
import numpy as np
from scipy.special import chdtr

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.core.geometry import Array, ellipse, pose_difference
from fej_slam_ros.core.records import NS
from fej_slam_ros.evaluation.run_evaluation import RunEvaluation
from fej_slam_ros.figure_files import save
from fej_slam_ros.palette import line_style

#: Scale of the ellipses and error bands [standard deviations].
ELLIPSE_SIGMAS = 3.0
#: Number of ellipses along the trajectory of a robot; more would overlap.
ELLIPSES_PER_ROBOT = 8
FIGURE_LANDMARK_COLOUR = '#666666'


def draw_trajectories(file: BinaryIO, evaluation: RunEvaluation) -> None:
    """Draw estimated trajectories and landmarks with 3-sigma ellipses over the ground truth."""
    figure = Figure(figsize=(9.0, 8.0), layout='constrained')
    axes = figure.subplots()
    for k, (name, matched) in enumerate(evaluation.in_map.items()):
        colour, line = line_style(k)
        axes.plot(
            *matched.true[:, :2].T, color='black', linewidth=0.9, zorder=1,
            label=None if k else 'true trajectory')
        axes.plot(
            *matched.poses[:, :2].T, line, color=colour, linewidth=1.6, label=name, zorder=3)
        axes.plot(*matched.poses[0, :2], 'o', color=colour, markersize=6, zorder=4)
        n = len(matched.stamps)
        for j in np.linspace(0, n - 1, min(ELLIPSES_PER_ROBOT, n), dtype=int):
            axes.add_patch(_ellipse(matched.poses[j, :2], matched.P[j, :2, :2], colour))
    _draw_landmarks(axes, evaluation)
    axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', adjustable='datalim')
    axes.set_title('Unaligned, frame map; 3-sigma ellipses; dots: first poses')
    axes.grid(alpha=0.25)
    save(file, figure, axes, 5)


def draw_errors(file: BinaryIO, evaluation: RunEvaluation) -> None:
    """Draw the errors of each robot over time with their estimated 3-sigma bounds."""
    rows = max(len(evaluation.in_map), 1)
    figure = Figure(figsize=(11.0, 1.2 + 2.3 * rows), layout='constrained')
    grid = figure.subplots(rows, 3, sharex=True, squeeze=False)
    for row, (name, matched) in zip(grid, evaluation.in_map.items()):
        errors = pose_difference(matched.poses, matched.true)
        seconds = (matched.stamps - _first_stamp(evaluation)) / NS
        for axis, (axes, unit) in enumerate(zip(row, ('x [m]', 'y [m]', 'heading [rad]'))):
            sigma = ELLIPSE_SIGMAS * np.sqrt(np.maximum(matched.P[:, axis, axis], 0.0))
            axes.fill_between(
                seconds, -sigma, sigma, color='#56b4e9', alpha=0.35, linewidth=0.0,
                label='estimated 3 sigma')
            axes.plot(seconds, errors[:, axis], color='black', linewidth=1.0, label='error')
            axes.set_ylabel(f'{name}: {unit}')
            axes.grid(alpha=0.25)
    for axes in grid[-1]:
        axes.set_xlabel('time [s]')
    figure.suptitle('Estimate - truth, unaligned')
    save(file, figure, grid[0, 0], 2)


def draw_nees(file: BinaryIO, evaluation: RunEvaluation) -> None:
    """Draw NEES/3 of each robot over time, and the coverage of its confidence regions."""
    figure = Figure(figsize=(11.0, 5.0), layout='constrained')
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    left.axhspan(*band_per_dof(3), color='#009e73', alpha=0.2, label='95 % band of one pose')
    left.axhline(1.0, color='black', linewidth=0.8, linestyle=':', label='consistent')
    p = np.linspace(0.0, 1.0, 101)
    right.plot(p, p, color='black', linewidth=0.8, linestyle=':')
    uncertain = {n: nees for n, nees in evaluation.nees.items() if np.isfinite(nees).any()}
    for k, (name, nees) in enumerate(uncertain.items()):
        colour, line = line_style(k)
        seconds = (evaluation.matched[name].stamps - _first_stamp(evaluation)) / NS
        left.plot(seconds, nees, line, color=colour, linewidth=1.1, label=name)
        inside = np.sort(chdtr(3, 3.0 * nees[np.isfinite(nees)]))
        right.plot(
            [0.0, *inside, 1.0], [0.0, *np.arange(1, len(inside) + 1) / len(inside), 1.0], line,
            color=colour, linewidth=1.5)
    left.set_yscale('log')
    left.set_ylim(bottom=max(left.get_ylim()[0], 1e-3))
    left.yaxis.set_major_formatter('{x:g}')
    left.set(xlabel='time [s]', ylabel='NEES/3', title='NEES: a mean above 1 is overconfident')
    right.set(
        xlabel='probability of the region', ylabel='share of errors inside',
        title='Coverage: below the diagonal is overconfident', aspect='equal')
    for axes in (left, right):
        axes.grid(alpha=0.25)
    save(file, figure, left, 5)


def _draw_landmarks(axes: Axes, evaluation: RunEvaluation) -> None:
    estimated = evaluation.result.landmarks
    true = np.array([*evaluation.truth.landmarks.values()]).reshape(-1, 2)
    if len(estimated.ids):
        axes.plot(
            *estimated.points.T, '^', color=FIGURE_LANDMARK_COLOUR, markersize=3,
            label='estimated landmark', zorder=4)
    for point, P in zip(estimated.points, estimated.P):
        axes.add_patch(_ellipse(point, P, FIGURE_LANDMARK_COLOUR))
    if len(true):
        axes.plot(*true.T, '+', color='black', markersize=7, label='true landmark')


def _first_stamp(evaluation: RunEvaluation) -> int:
    return min(int(matched.stamps[0]) for matched in evaluation.matched.values())


def _ellipse(at: Array, P: Array, colour: str) -> Ellipse:
    major, minor, angle = ellipse(P)
    return Ellipse(
        (at[0], at[1]), 2.0 * ELLIPSE_SIGMAS * major, 2.0 * ELLIPSE_SIGMAS * minor,
        angle=math.degrees(angle), color=colour, alpha=0.25, linewidth=1.0, zorder=2)
