# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The two simulated environments of [Liu], section 4.1: published numbers, shapes by formula."""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np

from fej_slam_ros.core.records import Record
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import make_world, World, WorldSettings


@dataclass(frozen=True)
class Environment:
    """Everything that a simulated run needs besides a random generator."""

    world: WorldSettings
    sensors: SensorSettings

    def true_world(self, rng: np.random.Generator) -> World:
        """Return a world."""
        return make_world(self.world, rng)

    def records(self, rng: np.random.Generator) -> Iterator[Record]:
        """Yield what the robots measure in the world that an equal generator makes."""
        return measure(self.true_world(rng), self.sensors, rng)


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
