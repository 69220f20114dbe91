# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Picture of a run: estimated trajectories and landmarks with ellipses, and ground truth."""

from collections.abc import Callable, Iterable, Mapping
from typing import BinaryIO, TYPE_CHECKING

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.evaluation.run_result import EstimatedTrajectory, LandmarkMap, RunResult
from fej_slam_ros.palette import robot_colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Name of the picture in a folder of results.
PICTURE = 'scene.png'
ELLIPSE_SIGMAS = 3.0
#: Maximum number of ellipses along a trajectory.
MAX_ELLIPSES = 25


def draw_run(
    file: BinaryIO, title: str, result: RunResult, robots: Iterable[str],
    true_poses: Mapping[str, Array], true_landmarks: Iterable[Array],
    draw_world: 'Callable[[Axes], None]' = lambda axes: None,
) -> None:
    """
    Draw the map and the trajectories of some robots in it, with the truth if there is any.

    True poses (k, 3) are given by robot, true landmarks are (2,) arrays. `draw_world` draws the
    background.
    """
    from matplotlib.figure import Figure

    from fej_slam_ros.experiments.common.drawing import TRUTH_COLOUR
    from fej_slam_ros.figure_files import save

    trajectories = {name: result.trajectories[name] for name in robots}
    figure = Figure(figsize=(7.0, 9.0), layout='constrained')
    axes = figure.subplots()
    draw_world(axes)
    true_points = np.array([*true_landmarks]).reshape(-1, 2)
    if len(true_points):
        axes.plot(*true_points.T, '+', markersize=7, color=TRUTH_COLOUR, label='true landmark')
    _draw_estimates(axes, trajectories, result.landmarks)
    axes.plot(
        [], [], 'o', fillstyle='none', color=TRUTH_COLOUR, markersize=9, label='3-sigma ellipse')
    for x in true_poses.values():
        axes.plot(x[:, 0], x[:, 1], color='black', linewidth=0.8)
    if true_poses:
        axes.plot([], [], color='black', linewidth=0.8, label='true path')
    starts = {name: trajectory.poses[0] for name, trajectory in trajectories.items()}
    for name, pose in {**starts, **{name: x[0] for name, x in true_poses.items()}}.items():
        _draw_start(axes, name, pose)
    # Of estimates in map alone, the first one is later than the start where a robot has joined.
    start = 'start' if true_poses else 'first pose in the frame'
    axes.plot([], [], 'o', color='black', markersize=5, label=start)
    # Of a wide scene, the space that is left is above it, where it is cut off.
    axes.set(title=title, xlabel='x [m]', ylabel='y [m]', aspect='equal', anchor='S')
    axes.grid(alpha=0.25)
    save(file, figure, axes, 3)


def _draw_estimates(
    axes: 'Axes', trajectories: Mapping[str, EstimatedTrajectory], landmarks: LandmarkMap
) -> None:
    """Draw trajectories and landmarks with their ellipses."""
    from fej_slam_ros.experiments.common.drawing import draw_ellipses

    for index, (name, trajectory) in enumerate(trajectories.items()):
        x, colour = trajectory.poses, robot_colour(index)
        axes.plot(x[:, 0], x[:, 1], color=colour, linewidth=1.2, label=f'{name}, estimated')
        stride = max(1, len(x) // MAX_ELLIPSES)
        draw_ellipses(axes, x[::stride], trajectory.P[::stride], colour, ELLIPSE_SIGMAS)
    axes.plot(*landmarks.points.T, '^', markersize=3, color='black', label='landmark, estimated')
    draw_ellipses(axes, landmarks.points, landmarks.P, 'black', ELLIPSE_SIGMAS)


def _draw_start(axes: 'Axes', name: str, pose: Array) -> None:
    """Draw the start (3,) of a robot with its name above everything else."""
    axes.plot(*pose[:2], marker='o', color='black', markersize=5)
    axes.annotate(
        name, (pose[0], pose[1]), (0, 8), textcoords='offset points', ha='center',
        fontsize='large',
        bbox={'facecolor': 'white', 'edgecolor': 'none', 'alpha': 0.8, 'pad': 1.0})
