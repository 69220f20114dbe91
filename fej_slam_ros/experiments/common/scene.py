# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Pictures of a run: trajectories, landmarks and their 3-sigma ellipses beside the truth."""

from collections.abc import Mapping
import math
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from fej_slam_ros.core.geometry import Array, ellipse
from fej_slam_ros.palette import robot_colour

SIGMAS = 3.0
#: Ellipses along a trajectory, so many at most.
MAX_ELLIPSES = 25
TRUTH = '#555555'


def draw_scene(
    path: Path, title: str, poses: Mapping[str, Array], covariances: Mapping[str, Array],
    points: Array, point_covariances: Array, true_poses: Mapping[str, Array], true_points: Array,
) -> None:
    """
    Draw estimate and truth of a run into a PNG.

    Parameters
    ----------
    path : the file
    title : what is seen
    poses, covariances : (K, 3) and (K, 3, 3) array of each robot, frame ``map``
    points, point_covariances : (n, 2) and (n, 2, 2) array of the landmarks, frame ``map``
    true_poses, true_points : (K, 3) array of each robot and (n, 2) array, frame ``map``

    """
    figure = Figure(figsize=(7.0, 9.0), layout='constrained')
    axes = figure.subplots()
    axes.plot(*true_points.T, '+', markersize=7, color=TRUTH, label='true landmark')
    for place, (name, x) in enumerate(poses.items()):
        colour = robot_colour(place)
        axes.plot(x[:, 0], x[:, 1], color=colour, linewidth=1.2, label=f'{name}, estimated')
        stride = max(1, len(x) // MAX_ELLIPSES)
        for pose, P in zip(x[::stride], covariances[name][::stride]):
            draw_ellipse(axes, pose[:2], P[:2, :2], colour)
    axes.plot(*points.T, '^', markersize=3, color='black', label='landmark, estimated')
    for point, P in zip(points, point_covariances):
        draw_ellipse(axes, point, P, 'black')
    axes.plot([], [], 'o', fillstyle='none', color=TRUTH, markersize=9, label='3-sigma ellipse')
    for name, x in true_poses.items():
        _draw_truth(axes, name, x)
    axes.plot([], [], color='black', linewidth=0.8, label='true path')
    axes.plot([], [], 'o', color='black', markersize=5, label='start')
    axes.set(title=title, xlabel='x [m]', ylabel='y [m]', aspect='equal')
    axes.grid(alpha=0.25)
    figure.legend(loc='outside lower center', ncols=4, fontsize='small')
    figure.savefig(path, dpi=110)


def _draw_truth(axes: Axes, name: str, x: Array) -> None:
    """Draw the true path of a robot, over what is estimated, and its name where it starts."""
    axes.plot(x[:, 0], x[:, 1], color='black', linewidth=0.8)
    axes.plot(*x[0, :2], marker='o', color='black', markersize=5)
    axes.annotate(
        name, (x[0, 0], x[0, 1]), (0, 8), textcoords='offset points', ha='center',
        fontsize='large',
        bbox={'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.8, 'pad': 1.0})


def draw_ellipse(
    axes: Axes, at: Array, P: Array, colour: str, sigmas: float = SIGMAS
) -> None:
    """Draw a position (2,) with covariance P (2, 2) as the ellipse of so many sigmas."""
    major, minor, angle = ellipse(P)
    axes.add_patch(Ellipse(
        (at[0], at[1]), 2.0 * sigmas * major, 2.0 * sigmas * minor, angle=math.degrees(angle),
        fill=False, edgecolor=colour, linewidth=0.8, alpha=0.8))
