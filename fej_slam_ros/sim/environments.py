# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulated experiments of the papers.

Of [Liu], section 4.1: published numbers, shapes by formula. Of [Andersson], section V, which
prints the sensors only: noise of driving, courses and areas are ours.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np

from fej_slam_ros.core.records import Record
from fej_slam_ros.sim import scanners
from fej_slam_ros.sim.driving import Leg
from fej_slam_ros.sim.encounters import Area, Encounter, EncounterSettings, make_encounter, Watch
from fej_slam_ros.sim.scanners import ScannerSettings
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import make_world, World, WorldSettings


@dataclass(frozen=True)
class Environment:
    """
    Everything that a simulated run needs besides a random generator.

    Attributes
    ----------
    world, sensors : what there is, and how it is measured
    shares_numbers : whether a number of a landmark is the same to all

    """

    world: WorldSettings
    sensors: SensorSettings
    shares_numbers: ClassVar[bool] = True

    @property
    def observers(self) -> tuple[str, ...]:
        """Return the robots that look for other robots."""
        return () if self.sensors.robot_sigma is None else self.world.robots

    def true_world(self, rng: np.random.Generator) -> World:
        """Return a world."""
        return make_world(self.world, rng)

    def records(self, rng: np.random.Generator) -> Iterator[Record]:
        """Yield what the robots measure in the world that an equal generator makes."""
        return measure(self.true_world(rng), self.sensors, rng)


@dataclass(frozen=True)
class EncounterEnvironment:
    """The same for an encounter of two robots, each with numbers of landmarks of its own."""

    world: EncounterSettings
    sensors: ScannerSettings
    shares_numbers: ClassVar[bool] = False

    @property
    def observers(self) -> tuple[str, ...]:
        """Return the robots that look for other robots."""
        return tuple(self.world.robots[watch.observer] for watch in self.world.watches)

    def true_world(self, rng: np.random.Generator) -> Encounter:
        """Return a world."""
        return make_encounter(self.world, rng)

    def records(self, rng: np.random.Generator) -> Iterator[Record]:
        """Yield what the robots measure in the world that an equal generator makes."""
        return scanners.measure(self.true_world(rng), self.world, self.sensors, rng)


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

#: Both robots of map joining turn about in an area of their own and leave it, see each other as
#: they pass between the areas, and each goes on into the area of the other.
ENCOUNTERS = {
    'map_joining': EncounterEnvironment(
        EncounterSettings(
            second_start=(-10.15, 3.85, math.pi),
            legs=(
                (
                    Leg(6, 0.0), Leg(20, math.pi), Leg(18, 0.0), Leg(8, math.radians(20.0)),
                    Leg(8, 0.0), Leg(8, math.radians(-20.0)), Leg(16, 0.0)),
                (
                    Leg(4, 0.0), Leg(18, math.pi), Leg(22, 0.0), Leg(8, math.radians(20.0)),
                    Leg(8, 0.0), Leg(8, math.radians(-20.0)), Leg(16, 0.0))),
            areas=(
                Area(40, (-1.3, -1.5), (7.0, 5.2)),
                Area(40, (-17.4, -1.5), (-9.1, 5.2)),
                Area(1, (-2.1, 2.2), (-1.7, 4.2)),
                Area(1, (-6.0, 7.2), (-4.5, 8.2)),
                Area(1, (-6.0, -4.3), (-4.0, -3.3))),
            watches=(Watch(0, 1, 44, 52), Watch(1, 0, 44, 52)),
            driving_sigma=(0.05, 0.02, 0.02)),
        ScannerSettings(field_of_view=math.radians(240.0))),
    # The second robot, on rough ground, drives beside the first one and a little ahead of it.
    'sensor_extension': EncounterEnvironment(
        EncounterSettings(
            second_start=(1.5, -2.0, 0.0),
            legs=(
                (Leg(25, math.radians(10.0)), Leg(50, math.radians(-20.0)),
                 Leg(25, math.radians(10.0))),) * 2,
            areas=(Area(60, (1.0, -6.0), (30.0, -1.6)), Area(30, (1.0, 0.6), (30.0, 4.0))),
            watches=(Watch(0, 1, 0, 100),),
            driving_sigma=(0.02, 0.01, 0.01), roughness=5.0),
        ScannerSettings(field_of_view=math.radians(180.0))),
}

AnyEnvironment = Environment | EncounterEnvironment
ALL_ENVIRONMENTS: dict[str, AnyEnvironment] = ENVIRONMENTS | ENCOUNTERS
