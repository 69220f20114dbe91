# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Ground truth of two robots that observe each other and have no other common reference.

Courses and landmark areas are given in the frame of the first robot's start, which is ``map``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, transform_poses
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.driving import drive, Leg, STEP
from fej_slam_ros.sim.world import World

#: Minimum distance of a landmark from the other landmarks and from the robots' paths [m].
SPACING = 0.35


class LandmarkArea(NamedTuple):
    """A rectangle between two corners (x, y) [m] and its number of landmarks."""

    landmarks: int
    low: tuple[float, float]
    high: tuple[float, float]


class ObservationWindow(NamedTuple):
    """Steps, first to last, in which a robot looks for another; robots by index, 0 or 1."""

    observer: int
    observed: int
    first: int
    last: int


@dataclass(frozen=True)
class RendezvousSettings:
    """Parameters of a rendezvous world; lengths in m, angles in rad."""

    second_start: tuple[float, float, float]  #: Start of the second robot, [x, y, phi]
    #: Course of each robot; both have the same number of steps.
    legs: tuple[tuple[Leg, ...], tuple[Leg, ...]]
    areas: tuple[LandmarkArea, ...]  #: Areas in which the landmarks are placed
    windows: tuple[ObservationWindow, ...]  #: When the robots look for each other
    #: Standard deviations of the first robot's (v, v_lat, omega) [m/s, m/s, rad/s].
    driving_sigma: tuple[float, float, float]
    roughness: float = 1.0  #: Ratio of the second robot's standard deviations to the first robot's
    robots: tuple[str, ...] = ('p', 'q')  #: Names of the two robots
    first_stamp: int = 0  #: Time of step 0 [ns]

    def __post_init__(self) -> None:
        """Reject any number of robots but two."""
        if len(self.robots) != 2:
            raise UsageError(
                f'robots: {len(self.robots)} names given, this environment has exactly two robots')

    @property
    def stamps(self) -> tuple[int, ...]:
        """Return the time of each step [ns]."""
        steps = sum(leg.steps for leg in self.legs[0])
        return tuple(self.first_stamp + k * STEP for k in range(steps + 1))

    @property
    def sigmas(self) -> tuple[Array, Array]:
        """Return the standard deviations (3,) of the driving vector of each robot."""
        sigma = np.array(self.driving_sigma)
        return sigma, self.roughness * sigma


@dataclass(frozen=True, eq=False)
class RendezvousWorld(World):
    """Ground truth of a rendezvous in the frame ``map``."""

    commands: Mapping[str, Array]  #: (K, 3) array of each robot, the driving vector u of each step
    #: True landmark ID by robot and by the robot's own landmark ID.
    landmark_of: Mapping[str, Mapping[int, int]]


def make_rendezvous_world(
    settings: RendezvousSettings, rng: np.random.Generator
) -> RendezvousWorld:
    """Return a world with random driving noise, landmark positions and landmark IDs per robot."""
    landmarks_rng, *robot_rngs = rng.spawn(3)
    starts = np.zeros(3), np.array(settings.second_start)
    paths = [
        drive(legs, sigma, robot_rng)
        for legs, sigma, robot_rng in zip(settings.legs, settings.sigmas, robot_rngs)]
    true_poses = [transform_poses(start, path.poses) for start, path in zip(starts, paths)]
    landmarks = _landmarks(settings.areas, np.vstack(true_poses)[:, :2], landmarks_rng)
    own_ids = [1 + robot_rng.permutation(len(landmarks)) for robot_rng in robot_rngs]
    robots = settings.robots
    return RendezvousWorld(
        robots, settings.stamps, dict(zip(robots, true_poses)), dict(enumerate(landmarks, 1)),
        {robot: path.commands for robot, path in zip(robots, paths)},
        {robot: dict(enumerate(ids.tolist(), 1)) for robot, ids in zip(robots, own_ids)})


def _landmarks(
    areas: Sequence[LandmarkArea], path: Array, rng: np.random.Generator
) -> list[Array]:
    """Return random points (2,) at least `SPACING` from each other and from the path (n, 2)."""
    points: list[Array] = []
    for count, low, high in areas:
        total = len(points) + count
        while len(points) < total:
            point = rng.uniform(low, high)
            if np.hypot(*(np.vstack([path, *points]) - point).T).min() >= SPACING:
                points.append(point)
    return points
