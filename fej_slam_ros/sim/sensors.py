# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Measurements of the robots of a synthetic world, with the noise model of [Liu]."""

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
    """The sensors of every robot; lengths in m, angles in rad."""

    #: Standard deviations of the increment (x, y, phi) of one step.
    odometry_sigma: tuple[float, float, float]
    #: Standard deviations of an observation (x, y) in the base frame.
    landmark_sigma: tuple[float, float]
    range: float = 15.0  #: Maximum true distance of an observed landmark or robot
    field_of_view: float = 2.0 * math.pi  #: Full angle, centred on the x axis
    #: Like landmark_sigma, for other robots; None if robots do not observe each other.
    robot_sigma: tuple[float, float] | None = None
    identities: bool = True  #: If False, observations carry no landmark ID
    clutter: float = 0.0  #: Fraction of a scan's observations that are clutter; clutter has no ID
    missed: float = 0.0  #: Fraction of the landmarks in view that are not detected


def in_view(z: Array, max_range: float, field_of_view: float) -> Indices:
    """Return the indices of the points (n, 2), in the sensor frame, that are in view."""
    in_range = np.hypot(*z.T) <= max_range
    ahead = np.abs(np.arctan2(*z.T[::-1])) <= field_of_view / 2.0
    return np.flatnonzero(in_range & ahead)


def measure(world: World, settings: SensorSettings, rng: np.random.Generator) -> Iterator[Record]:
    """
    Yield the records of one run in the order of stamps, the true landmarks first.

    At each stamp every robot has its odometry, its scan, its true pose, and its robot scan if
    robots observe each other. Each sensor has a stream of random numbers of its own, spawned from
    the generator, so its noise depends neither on the number of robots nor on other sensors.
    """
    yield TrueLandmarks(world.landmarks, world.stamps[0])
    sources: list[Iterator[Record]] = []
    for robot, robot_rng in zip(world.robots, rng.spawn(len(world.robots))):
        odometry_rng, scan_rng, robots_rng, detection_rng = robot_rng.spawn(4)
        sources += [
            odometry(world, robot, settings.odometry_sigma, odometry_rng),
            detected(scans(world, robot, settings, scan_rng), settings, detection_rng),
            true_poses(world, robot)]
        if settings.robot_sigma is not None:
            sources.append(robot_scans(world, robot, settings, settings.robot_sigma, robots_rng))
    for records_at_stamp in zip(*sources):
        yield from records_at_stamp


def odometry(
    world: World, robot: str, sigma: tuple[float, float, float], rng: np.random.Generator
) -> Iterator[Odometry]:
    """
    Yield the integrated odometry of a robot from [0, 0, 0].

    The noise, of standard deviations sigma, is added to the increment in the base frame at its
    beginning, eq. (2) of [Liu]. The message at its end carries the covariance Q as that of the
    mean twist, Q / dt^2; the first message has no increment and no covariance.
    """
    Q = np.diag(np.square(sigma))
    poses, stamps = world.true_poses[robot], world.stamps
    pose = np.zeros(3)
    yield Odometry(robot, stamps[0], pose, None)
    for k in range(1, len(stamps)):
        u = between(poses[k - 1], poses[k]) + rng.normal(0.0, sigma)
        pose = compose(pose, u)
        dt = (stamps[k] - stamps[k - 1]) * 1e-9
        yield Odometry(robot, stamps[k], pose, Q / dt**2)


def scans(
    world: World, robot: str, settings: SensorSettings, rng: np.random.Generator
) -> Iterator[Scan]:
    """Yield a scan at each stamp, in the order of IDs; it is empty if nothing is in view."""
    R = np.diag(np.square(settings.landmark_sigma))
    ids, points = np.array(list(world.landmarks)), np.array(list(world.landmarks.values()))
    for stamp, pose in zip(world.stamps, world.true_poses[robot]):
        observed, z = _observe(pose, points, settings, settings.landmark_sigma, rng)
        yield Scan(
            robot, stamp, tuple(Observation(int(i), z_i, R) for i, z_i in zip(ids[observed], z)))


def detected(
    scans: Iterable[Scan], settings: SensorSettings, rng: np.random.Generator
) -> Iterator[Scan]:
    """Yield the scans with missed detections and clutter, and without IDs if so configured."""
    if settings.identities and not settings.missed and not settings.clutter:
        yield from scans
        return
    max_range, half = settings.range, settings.field_of_view / 2.0
    R = np.diag(np.square(settings.landmark_sigma))
    clutter_per_observation = settings.clutter / (1.0 - settings.clutter)
    for scan in scans:
        observations = [s for s in scan.observations if rng.random() >= settings.missed]
        if not settings.identities:
            observations = [replace(s, id=NO_ID) for s in observations]
        count = rng.poisson(clutter_per_observation * len(observations))
        # Uniform over the area in view.
        ranges = max_range * np.sqrt(rng.random(count))
        bearings = rng.uniform(-half, half, count)
        clutter = np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])
        observations += [Observation(NO_ID, z, R) for z in clutter]
        shuffled = [observations[k] for k in rng.permutation(len(observations))]
        yield replace(scan, observations=ordered(shuffled))


def robot_scans(
    world: World, robot: str, settings: SensorSettings, sigma: tuple[float, float],
    rng: np.random.Generator,
) -> Iterator[RobotScan]:
    """Yield the observations of the other robots at each stamp, in the order of the robots."""
    R = np.diag(np.square(sigma))
    others = [other for other in world.robots if other != robot]
    for k, (stamp, pose) in enumerate(zip(world.stamps, world.true_poses[robot])):
        points = np.array([world.true_poses[other][k, :2] for other in others]).reshape(-1, 2)
        observed, z = _observe(pose, points, settings, sigma, rng)
        yield RobotScan(robot, stamp, tuple(
            RobotObservation(others[i], z_i, R) for i, z_i in zip(observed, z)))


def true_poses(world: World, robot: str) -> Iterator[TruePose]:
    """Yield the true pose of a robot at each stamp."""
    for stamp, pose in zip(world.stamps, world.true_poses[robot]):
        yield TruePose(robot, stamp, pose)


def _observe(
    pose: Array, points: Array, settings: SensorSettings, sigma: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[Indices, Array]:
    """Return indices and noisy z of the points (n, 2) in view of a pose, eq. (7) of [Liu]."""
    z_true = (points - pose[:2]) @ rotation(pose[2])
    observed = in_view(z_true, settings.range, settings.field_of_view)
    return observed, z_true[observed] + rng.normal(0.0, sigma, (len(observed), 2))
