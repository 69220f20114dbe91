# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Two robots that see each other and know nothing else of each other: what is true of them.

Courses and areas of landmarks are given in the frame of the first robot's start, which is
``map``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, transform_poses
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.driving import drive, Leg, STEP
from fej_slam_ros.sim.world import World

#: Landmarks are at least so far from each other, and from the ways of the robots [m].
SPACING = 0.35


class Area(NamedTuple):
    """So many landmarks between two corners (x, y) [m]."""

    landmarks: int
    low: tuple[float, float]
    high: tuple[float, float]


class Watch(NamedTuple):
    """Which robot looks for which, 0 for the first, from a step on and up to a step."""

    observer: int
    seen: int
    first: int
    last: int


@dataclass(frozen=True)
class EncounterSettings:
    """
    What an encounter is made from; lengths in m, angles in rad.

    Attributes
    ----------
    second_start : where the second robot starts, [x, y, phi]
    legs : the course of each robot; both have equally many steps
    areas : where the landmarks stand
    watches : when the robots look for each other
    driving_sigma : standard deviations of the first robot's (v, v_lat, omega) [m/s, m/s, rad/s]
    roughness : how many times as large those of the second robot are
    robots : their names
    first_stamp : time of step 0 [ns]

    """

    second_start: tuple[float, float, float]
    legs: tuple[tuple[Leg, ...], tuple[Leg, ...]]
    areas: tuple[Area, ...]
    watches: tuple[Watch, ...]
    driving_sigma: tuple[float, float, float]
    roughness: float = 1.0
    robots: tuple[str, ...] = ('p', 'q')
    first_stamp: int = 0

    def __post_init__(self) -> None:
        """Refuse other than two robots."""
        if len(self.robots) != 2:
            raise UsageError(f'robots: {len(self.robots)} are given, name the two that meet')

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
class Encounter(World):
    """
    The truth of an encounter, in the frame ``map``.

    Attributes
    ----------
    commands : (K, 3) array of each robot, the driving vector u of each step
    landmark_of : of each robot, the landmark that each of its own numbers means

    """

    commands: Mapping[str, Array]
    landmark_of: Mapping[str, Mapping[int, int]]


def make_encounter(settings: EncounterSettings, rng: np.random.Generator) -> Encounter:
    """Return an encounter with random noise of the drives, landmarks and numbers of landmarks."""
    landmarks_rng, *robot_rngs = rng.spawn(3)
    starts = np.zeros(3), np.array(settings.second_start)
    drives = [
        drive(legs, sigma, robot_rng)
        for legs, sigma, robot_rng in zip(settings.legs, settings.sigmas, robot_rngs)]
    ways = [transform_poses(start, driven.poses) for start, driven in zip(starts, drives)]
    landmarks = _landmarks(settings.areas, np.vstack(ways)[:, :2], landmarks_rng)
    numbers = [1 + robot_rng.permutation(len(landmarks)) for robot_rng in robot_rngs]
    return Encounter(
        settings.robots, settings.stamps, dict(zip(settings.robots, ways)),
        dict(enumerate(landmarks, start=1)),
        {robot: driven.commands for robot, driven in zip(settings.robots, drives)},
        {
            robot: dict(enumerate(of_robot.tolist(), start=1))
            for robot, of_robot in zip(settings.robots, numbers)})


def _landmarks(areas: Sequence[Area], way: Array, rng: np.random.Generator) -> list[Array]:
    """Return random points (2,) that keep away from each other and from points (n, 2)."""
    points: list[Array] = []
    for count, low, high in areas:
        wanted = len(points) + count
        while len(points) < wanted:
            point = rng.uniform(low, high)
            if np.hypot(*(np.vstack([way, *points]) - point).T).min() >= SPACING:
                points.append(point)
    return points
