# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two simulated environments of [Liu], section 4.1: published numbers, shapes by formula."""

from dataclasses import dataclass
import math

from fej_slam_ros.sim.sensors import SensorSettings
from fej_slam_ros.sim.world import WorldSettings


@dataclass(frozen=True)
class Environment:
    """Everything that a simulated run needs besides a random generator."""

    world: WorldSettings
    sensors: SensorSettings


ENVIRONMENTS = {
    'circles': Environment(
        WorldSettings('circles', loop_lengths=(164.45, 145.33), steps_per_loop=63),
        SensorSettings(odometry_sigma=(0.3, 0.3, math.radians(2.0)), landmark_sigma=(0.5, 0.5)),
    ),
    'figure_eight': Environment(
        WorldSettings('figure_eight', loop_lengths=(247.20, 211.41), steps_per_loop=40),
        SensorSettings(odometry_sigma=(0.2, 0.2, math.radians(3.0)), landmark_sigma=(0.6, 0.6)),
    ),
}
