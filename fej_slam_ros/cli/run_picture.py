# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Picture of the results of a run."""

from collections.abc import Callable, Iterable, Mapping
from typing import BinaryIO, TYPE_CHECKING

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.evaluation.run_result import RunResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Name of the picture in a folder of results.
PICTURE = 'scene.png'


def draw_run(
    file: BinaryIO, title: str, result: RunResult, robots: Iterable[str],
    true_poses: Mapping[str, Array], true_landmarks: Iterable[Array],
    draw_world: 'Callable[[Axes], None]' = lambda axes: None,
) -> None:
    """Draw the map and the trajectories of some robots in it, with the truth if there is any."""
    from fej_slam_ros.experiments.common.scene import draw_scene

    trajectories = {name: result.trajectories[name] for name in robots}
    draw_scene(
        file, title, {name: trajectory.poses for name, trajectory in trajectories.items()},
        {name: trajectory.P for name, trajectory in trajectories.items()}, result.landmarks.points,
        result.landmarks.P, true_poses, np.array([*true_landmarks]).reshape(-1, 2), draw_world)
