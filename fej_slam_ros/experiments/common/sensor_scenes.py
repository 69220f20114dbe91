# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Worlds of lasers or tags behind the estimates, and what each robot sees at the end."""

import math

from matplotlib.axes import Axes
from matplotlib.patches import Circle, Wedge
import numpy as np

from fej_slam_ros.core.geometry import transform
from fej_slam_ros.experiments.common.drawing import TRUTH_COLOUR
from fej_slam_ros.palette import robot_colour
from fej_slam_ros.sim.laser_world import LaserWorld
from fej_slam_ros.sim.lidar import LidarSettings, true_ranges
from fej_slam_ros.sim.tags import CameraSettings, TagWorld

#: Length of the normal of a tag in the picture [m].
NORMAL = 0.5


def draw_laser_world(axes: Axes, world: LaserWorld, lidar: LidarSettings) -> None:
    """Draw walls, posts with their radii, and what each laser sees at the end."""
    for x0, y0, x1, y1 in world.walls:
        axes.plot([x0, x1], [y0, y1], color='0.4', linewidth=2.0)
    for x, y, radius in world.posts:
        axes.add_patch(Circle((x, y), radius, facecolor=TRUTH_COLOUR, alpha=0.4))
    discs = np.vstack([world.posts, world.legs(world.stamps[-1] * 1e-9)])
    for index, poses in enumerate(world.true_poses.values()):
        ranges = true_ranges(
            np.tile(poses[-1], (lidar.beams, 1)), lidar.angles, discs, world.walls)
        ranges[ranges > lidar.range] = np.nan
        points = ranges[:, None] * np.stack([np.cos(lidar.angles), np.sin(lidar.angles)], 1)
        axes.plot(
            *transform(poses[-1], points).T, '.', markersize=2, color=robot_colour(index),
            alpha=0.6)
    if len(world.walls):
        axes.plot([], [], color='0.4', linewidth=2.0, label='wall')
    axes.plot([], [], '.', color='0.4', label='laser scan at the end')


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
    axes.plot([], [], color=TRUTH_COLOUR, linewidth=1.0, label='side that a tag faces')
    axes.fill([], [], color='0.4', alpha=0.15, label='view of a camera at the end')
