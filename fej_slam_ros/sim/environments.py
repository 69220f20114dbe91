# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The simulated experiments of the papers.

[Liu], section 4.1: published noise and loop lengths, shapes by formula. [Andersson], section V:
published sensors; driving noise, courses and landmark areas are chosen here.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import ClassVar

import numpy as np

from fej_slam_ros.core.records import Record
from fej_slam_ros.detection.records import AnyRecord
from fej_slam_ros.sim import laser_world, scanners, tags
from fej_slam_ros.sim.driving import Leg
from fej_slam_ros.sim.laser_world import LaserWorld, LaserWorldSettings, make_laser_world
from fej_slam_ros.sim.lidar import LidarSettings
from fej_slam_ros.sim.rendezvous_world import (
    LandmarkArea, make_rendezvous_world, ObservationWindow, RendezvousSettings, RendezvousWorld)
from fej_slam_ros.sim.scanners import ScannerSettings
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.tags import CameraSettings, make_tag_world, TagWorld
from fej_slam_ros.sim.world import make_world, World, WorldSettings


@dataclass(frozen=True)
class Environment:
    """Everything that a simulated run needs besides a random generator."""

    #: Parameters of the ground truth and of its measurement.
    world: WorldSettings
    sensors: SensorSettings
    #: If True, an ID denotes the same landmark for all robots.
    shared_landmark_ids: ClassVar[bool] = True

    @property
    def observers(self) -> tuple[str, ...]:
        """Return the robots that observe other robots."""
        return () if self.sensors.robot_sigma is None else self.world.robots

    def true_world(self, rng: np.random.Generator) -> World:
        """Return the ground truth."""
        return make_world(self.world, rng)

    def records(self, rng: np.random.Generator) -> Iterator[Record]:
        """Yield measurements in the world that a generator in the same state makes."""
        return measure(self.true_world(rng), self.sensors, rng)


@dataclass(frozen=True)
class RendezvousEnvironment:
    """Two robots that observe each other; each has landmark IDs of its own."""

    world: RendezvousSettings
    sensors: ScannerSettings
    shared_landmark_ids: ClassVar[bool] = False

    @property
    def observers(self) -> tuple[str, ...]:
        """Return the robots that observe other robots."""
        return tuple(self.world.robots[window.observer] for window in self.world.windows)

    def true_world(self, rng: np.random.Generator) -> RendezvousWorld:
        """Return the ground truth."""
        return make_rendezvous_world(self.world, rng)

    def records(self, rng: np.random.Generator) -> Iterator[Record]:
        """Yield measurements in the world that a generator in the same state makes."""
        return scanners.measure(self.true_world(rng), self.world, self.sensors, rng)


@dataclass(frozen=True)
class LaserEnvironment:
    """Robots with planar lasers among posts; their scans are not yet observations."""

    world: LaserWorldSettings
    sensors: LidarSettings
    shared_landmark_ids: ClassVar[bool] = True
    observers: ClassVar[tuple[str, ...]] = ()

    def true_world(self, rng: np.random.Generator) -> LaserWorld:
        """Return the ground truth."""
        return make_laser_world(self.world, rng)

    def records(self, rng: np.random.Generator) -> Iterator[AnyRecord]:
        """Yield measurements in the world that a generator in the same state makes."""
        return laser_world.measure(self.true_world(rng), self.sensors, rng)


@dataclass(frozen=True)
class TagEnvironment:
    """Robots with cameras among tags, which they carry too."""

    world: WorldSettings
    sensors: CameraSettings
    shared_landmark_ids: ClassVar[bool] = True
    observers: ClassVar[tuple[str, ...]] = ()

    def true_world(self, rng: np.random.Generator) -> TagWorld:
        """Return the ground truth."""
        return make_tag_world(self.world, rng)

    def records(self, rng: np.random.Generator) -> Iterator[AnyRecord]:
        """Yield measurements in the world that a generator in the same state makes."""
        return tags.measure(self.true_world(rng), self.sensors, rng)


ENVIRONMENTS = {
    'circles': Environment(
        WorldSettings('circles', loop_lengths=(164.45, 145.33), steps_per_loop=63),
        SensorSettings(odometry_sigma=(0.3, 0.3, math.radians(2.0)), landmark_sigma=(0.5, 0.5))),
    'figure_eight': Environment(
        WorldSettings('figure_eight', loop_lengths=(247.20, 211.41), steps_per_loop=40),
        SensorSettings(odometry_sigma=(0.2, 0.2, math.radians(3.0)), landmark_sigma=(0.6, 0.6))),
}

#: Map joining: each robot turns around in an area of its own and leaves it, the robots observe
#: each other while they pass between the areas, and each goes on into the area of the other.
RENDEZVOUS_ENVIRONMENTS = {
    'map_joining': RendezvousEnvironment(
        RendezvousSettings(
            second_start=(-10.15, 3.85, math.pi),
            legs=(
                (Leg(6, 0.0), Leg(20, math.pi), Leg(18, 0.0), Leg(8, math.radians(20.0)),
                 Leg(8, 0.0), Leg(8, math.radians(-20.0)), Leg(16, 0.0)),
                (Leg(4, 0.0), Leg(18, math.pi), Leg(22, 0.0), Leg(8, math.radians(20.0)),
                 Leg(8, 0.0), Leg(8, math.radians(-20.0)), Leg(16, 0.0))),
            areas=(
                LandmarkArea(40, (-1.3, -1.5), (7.0, 5.2)),
                LandmarkArea(40, (-17.4, -1.5), (-9.1, 5.2)),
                LandmarkArea(1, (-2.1, 2.2), (-1.7, 4.2)),
                LandmarkArea(1, (-6.0, 7.2), (-4.5, 8.2)),
                LandmarkArea(1, (-6.0, -4.3), (-4.0, -3.3))),
            windows=(ObservationWindow(0, 1, 44, 52), ObservationWindow(1, 0, 44, 52)),
            driving_sigma=(0.05, 0.02, 0.02)),
        ScannerSettings(field_of_view=math.radians(240.0))),
    # The second robot, on rough ground, drives beside the first one and slightly ahead of it.
    'sensor_extension': RendezvousEnvironment(
        RendezvousSettings(
            second_start=(1.5, -2.0, 0.0),
            legs=(
                (Leg(25, math.radians(10.0)), Leg(50, math.radians(-20.0)),
                 Leg(25, math.radians(10.0))),) * 2,
            areas=(
                LandmarkArea(60, (1.0, -6.0), (30.0, -1.6)),
                LandmarkArea(30, (1.0, 0.6), (30.0, 4.0))),
            windows=(ObservationWindow(0, 1, 0, 100),),
            driving_sigma=(0.02, 0.01, 0.01), roughness=5.0),
        ScannerSettings(field_of_view=math.radians(180.0))),
}

AnyEnvironment = Environment | RendezvousEnvironment | LaserEnvironment | TagEnvironment
ALL_ENVIRONMENTS: dict[str, AnyEnvironment] = {
    **ENVIRONMENTS, **RENDEZVOUS_ENVIRONMENTS,
    'posts': LaserEnvironment(LaserWorldSettings(), LidarSettings()),
    'tags': TagEnvironment(
        WorldSettings(
            'circles', loop_lengths=(30.0, 25.0), steps_per_loop=1500, landmarks=24, loops=2,
            rate=25.0), CameraSettings())}
