# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the robots of a synthetic world measure, with the noise model of [Liu]."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, Indices, rotation
from fej_slam_ros.core.records import (
    NO_ID, Observation, Odometry, ordered, Record, RobotObservation, RobotScan, Scan,
    TrueLandmarks, TruePose)
from fej_slam_ros.sim.world import World


@dataclass(frozen=True)
class SensorSettings:
    """
    The sensors of every robot; lengths in m, angles in rad.

    Attributes
    ----------
    odometry_sigma : standard deviations of the increment (x, y, phi) of one step
    landmark_sigma : standard deviations of an observation (x, y) in the base frame
    range : largest true distance at which a landmark or robot is seen
    field_of_view : full angle around straight ahead in which they are seen
    robot_sigma : as landmark_sigma, of another robot; None where robots do not look for each other
    identities : whether a robot knows which landmark it sees
    clutter : part of its observations that are of nothing, where nobody knows what
    missed : part of the landmarks in view that it does not see

    """

    odometry_sigma: tuple[float, float, float]
    landmark_sigma: tuple[float, float]
    range: float = 15.0
    field_of_view: float = 2.0 * math.pi
    robot_sigma: tuple[float, float] | None = None
    identities: bool = True
    clutter: float = 0.0
    missed: float = 0.0


def in_view(z: Array, reach: float, field_of_view: float) -> Indices:
    """Return which points (n, 2), given in the frame of a sensor, it sees."""
    in_range = np.hypot(*z.T) <= reach
    ahead = np.abs(np.arctan2(*z.T[::-1])) <= field_of_view / 2.0
    return np.flatnonzero(in_range & ahead)


def measure(world: World, settings: SensorSettings, rng: np.random.Generator) -> Iterator[Record]:
    """
    Yield the records of one run in the order of stamps, the true landmarks first.

    At each stamp every robot gives its odometry, its scan, its true pose, and where robots look
    for each other what it sees of the others. Each sensor draws from a stream of its own, spawned
    from the generator, so its noise depends neither on how many robots follow nor on what else
    they measure.
    """
    yield TrueLandmarks(world.landmarks, world.stamps[0])
    sources: list[Iterator[Record]] = []
    for robot, robot_rng in zip(world.robots, rng.spawn(len(world.robots))):
        odometry_rng, scan_rng, robots_rng, detection_rng = robot_rng.spawn(4)
        sources += [
            odometry(world, robot, settings, odometry_rng),
            detected(scans(world, robot, settings, scan_rng), settings, detection_rng),
            true_poses(world, robot),
        ]
        if settings.robot_sigma is not None:
            sources.append(robot_scans(world, robot, settings, settings.robot_sigma, robots_rng))
    for records_at_stamp in zip(*sources):
        yield from records_at_stamp


def odometry(
    world: World, robot: str, settings: SensorSettings, rng: np.random.Generator
) -> Iterator[Odometry]:
    """
    Yield the integrated odometry of a robot, which starts at [0, 0, 0].

    The noise is added to the increment in the base frame at its beginning, eq. (2) of [Liu]. Its
    covariance Q goes into the later message as that of a mean twist, Q / dt^2; the first message
    ends no increment and has none.
    """
    Q = np.diag(np.square(settings.odometry_sigma))
    poses, stamps = world.true_poses[robot], world.stamps
    pose = np.zeros(3)
    yield Odometry(robot, stamps[0], pose, None)
    for k in range(1, len(stamps)):
        u = between(poses[k - 1], poses[k]) + rng.normal(0.0, settings.odometry_sigma)
        pose = compose(pose, u)
        dt = (stamps[k] - stamps[k - 1]) * 1e-9
        yield Odometry(robot, stamps[k], pose, Q / dt**2)


def scans(
    world: World, robot: str, settings: SensorSettings, rng: np.random.Generator
) -> Iterator[Scan]:
    """Yield a scan at each stamp, in the order of ids; it is empty where nothing is in view."""
    R = np.diag(np.square(settings.landmark_sigma))
    ids, positions = np.array(list(world.landmarks)), np.array(list(world.landmarks.values()))
    for stamp, pose in zip(world.stamps, world.true_poses[robot]):
        seen, z = _look(pose, positions, settings, settings.landmark_sigma, rng)
        yield Scan(robot, stamp, tuple(Observation(int(i), z_i, R) for i, z_i in zip(ids[seen], z)))


def detected(
    scans: Iterable[Scan], settings: SensorSettings, rng: np.random.Generator
) -> Iterator[Scan]:
    """Yield what a detector makes of scans: it misses some, adds clutter, and maybe names none."""
    reach, half = settings.range, settings.field_of_view / 2.0
    R = np.diag(np.square(settings.landmark_sigma))
    clutter_per_observation = settings.clutter / (1.0 - settings.clutter)
    for scan in scans:
        found = [s for s in scan.observations if rng.random() >= settings.missed]
        if not settings.identities:
            found = [replace(s, id=NO_ID) for s in found]
        count = rng.poisson(clutter_per_observation * len(found))
        # Uniform over the ground in view.
        ranges = reach * np.sqrt(rng.random(count))
        bearings = rng.uniform(-half, half, count)
        clutter = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
        found += [Observation(NO_ID, z, R) for z in clutter]
        shuffled = [found[k] for k in rng.permutation(len(found))]
        yield replace(scan, observations=ordered(shuffled))


def robot_scans(
    world: World, robot: str, settings: SensorSettings, sigma: tuple[float, float],
    rng: np.random.Generator,
) -> Iterator[RobotScan]:
    """Yield what a robot sees of the others at each stamp, in the order of the robots."""
    R = np.diag(np.square(sigma))
    others = [other for other in world.robots if other != robot]
    for k, (stamp, pose) in enumerate(zip(world.stamps, world.true_poses[robot])):
        there = np.array([world.true_poses[other][k, :2] for other in others]).reshape(-1, 2)
        seen, z = _look(pose, there, settings, sigma, rng)
        yield RobotScan(
            robot, stamp, tuple(RobotObservation(others[i], z_i, R) for i, z_i in zip(seen, z)))


def _look(
    pose: Array, points: Array, settings: SensorSettings, sigma: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Indices, Array]:
    """Return which points (n, 2) are seen from a pose (3,), and how, eq. (7) of [Liu]."""
    z_true = (points - pose[:2]) @ rotation(pose[2])
    seen = in_view(z_true, settings.range, settings.field_of_view)
    return seen, z_true[seen] + rng.normal(0.0, sigma, (len(seen), 2))


def true_poses(world: World, robot: str) -> Iterator[TruePose]:
    """Yield the true pose of a robot at each stamp."""
    for stamp, pose in zip(world.stamps, world.true_poses[robot]):
        yield TruePose(robot, stamp, pose)
