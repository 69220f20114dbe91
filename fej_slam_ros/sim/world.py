# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ground truth of a synthetic world: robots and landmarks."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, transform, transform_poses
from fej_slam_ros.errors import UsageError
from fej_slam_ros.sim.trajectories import LAYOUTS, team_loops

#: Distance of landmarks 1 and 2, which all robots share at step 0, from the centre of the
#: starts [m].
START_LANDMARK_OFFSET = 3.0
#: Half-width of the band around the paths in which the other landmarks lie [m].
BAND_HALF_WIDTH = 5.0


@dataclass(frozen=True)
class WorldSettings:
    """Parameters of a world; lengths in m, angles in rad."""

    #: Layout of the loops, ``circles`` or ``figure_eight`` (robots 1, 3, ... on a circle, 2, 4,
    #: ... on a figure eight).
    environment: str
    #: Length of a loop of robots 1, 3, ... and of robots 2, 4, ...
    loop_lengths: tuple[float, float]
    steps_per_loop: int  #: Number of steps in a loop
    robots: tuple[str, ...] = ('r1', 'r2')  #: Names; the first one starts at `start`
    landmarks: int = 60  #: Number of landmarks, at least 2
    loops: int = 5  #: Number of loops that each robot drives
    rate: float = 5.0  #: Steps per second [Hz]
    first_stamp: int = 0  #: Time of step 0 [ns]
    #: Pose [x, y, phi] of the first robot at step 0 in the frame ``map``.
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Reject an unknown layout and too few landmarks."""
        if self.environment not in LAYOUTS:
            raise UsageError(
                f"environment: '{self.environment}' is unknown, use one of {', '.join(LAYOUTS)}")
        if self.landmarks < 2:
            raise UsageError(
                f'landmarks: {self.landmarks} are too few for a common start, use 2 or more')

    @property
    def stamps(self) -> tuple[int, ...]:
        """Return the time of each step [ns]."""
        return step_stamps(self.first_stamp, self.loops * self.steps_per_loop, self.rate)


@dataclass(frozen=True, eq=False)
class World:
    """Ground truth in the frame ``map``."""

    robots: tuple[str, ...]  #: Names
    stamps: tuple[int, ...]  #: Time of each step [ns], common to all robots
    #: (K + 1, 3) array [x, y, phi] of each robot at the stamps [m, m, rad].
    true_poses: Mapping[str, Array]
    #: (2,) position [m] of each landmark by its ID, in the order of IDs from 1.
    landmarks: Mapping[int, Array]


def make_world(settings: WorldSettings, rng: np.random.Generator) -> World:
    """
    Return a world with random landmarks.

    Landmarks 1 and 2 stand near the centre of the robots' starts: at the published loop lengths
    every robot has them within 12.5 m at step 0, which determines all starts. The others lie along
    the paths, in the order in which the robots, one after another, pass them.
    """
    pair = LAYOUTS[settings.environment](settings.loop_lengths, settings.steps_per_loop)
    loops, centre = team_loops(pair, len(settings.robots))
    landmarks = np.vstack(
        [_around_start(centre, rng), _along_paths(loops, settings.landmarks - 2, rng)])
    start = np.array(settings.start)
    true_poses = [repeated(transform_poses(start, loop), settings.loops) for loop in loops]
    return World(
        settings.robots, settings.stamps, dict(zip(settings.robots, true_poses)),
        dict(enumerate(transform(start, landmarks), start=1)))


def step_stamps(first: int, steps: int, rate: float) -> tuple[int, ...]:
    """Return the time of step 0 and of each further one [ns] at a rate [Hz]."""
    return tuple(first + round(k * 1e9 / rate) for k in range(steps + 1))


def repeated(loop: Array, times: int) -> Array:
    """Return the poses of a loop that is driven several times."""
    return np.vstack([np.tile(loop[:-1], (times, 1)), loop[:1]])


def _around_start(centre: Array, rng: np.random.Generator) -> Array:
    """Return two points on opposite sides of the centre of the starts."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    offset = START_LANDMARK_OFFSET * np.array([np.cos(angle), np.sin(angle)])
    return np.array([centre + offset, centre - offset])


def _along_paths(loops: list[Array], count: int, rng: np.random.Generator) -> Array:
    """Return (count, 2) points, each beside its own equal share of the loops' total length."""
    begins = np.vstack([loop[:-1, :2] for loop in loops])
    steps = np.vstack([np.diff(loop[:, :2], axis=0) for loop in loops])
    travelled = np.cumsum(np.hypot(*steps.T))
    share = (np.arange(count) + rng.random(count)) / count
    index = np.searchsorted(travelled, share * travelled[-1])
    points: Array = begins[index] + rng.uniform(-BAND_HALF_WIDTH, BAND_HALF_WIDTH, (count, 2))
    return points
