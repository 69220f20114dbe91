# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A world of tags behind the estimates: their faces, and the view of each camera."""

import math

from matplotlib.axes import Axes
from matplotlib.patches import Wedge

from fej_slam_ros.experiments.common.drawing import TRUTH_COLOUR
from fej_slam_ros.palette import robot_colour
from fej_slam_ros.sim.tags import CameraSettings, TagWorld

#: Length of the normal of a tag in the picture [m].
NORMAL = 0.5


def draw_tag_world(axes: Axes, world: TagWorld, camera: CameraSettings) -> None:
    """Draw the direction in which each tag faces, and what each camera sees at the end."""
    for id_, (x, y) in world.landmarks.items():
        normal = world.normals[id_]
        axes.plot(
            [x, x + NORMAL * math.cos(normal)], [y, y + NORMAL * math.sin(normal)],
            color=TRUTH_COLOUR, linewidth=1.0)
    half = camera.field_of_view / 2.0
    for index, poses in enumerate(world.true_poses.values()):
        x, y, heading = poses[-1].tolist()
        axes.add_patch(Wedge(
            (x, y), camera.range, math.degrees(heading - half), math.degrees(heading + half),
            facecolor=robot_colour(index), alpha=0.15))
