# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Range-bearing scanners in a rendezvous world, section III-B of [Andersson]."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation
from fej_slam_ros.core.records import Observation, Record, RobotObservation, RobotScan, Scan
from fej_slam_ros.sim.driving import odometry
from fej_slam_ros.sim.rendezvous_world import RendezvousSettings, RendezvousWorld
from fej_slam_ros.sim.sensors import in_view, true_poses


@dataclass(frozen=True)
class ScannerSettings:
    """The scanner of every robot; lengths in m, angles in rad."""

    field_of_view: float  #: Full angle around straight ahead
    #: Standard deviations of a range and of a bearing.
    polar_sigma: tuple[float, float] = (0.01, 0.012)
    range: float = 4.0  #: Maximum true range


def measure(
    world: RendezvousWorld, settings: RendezvousSettings, scanner: ScannerSettings,
    rng: np.random.Generator,
) -> Iterator[Record]:
    """
    Yield the records of a run in the order of stamps.

    At each stamp every robot gives its odometry, its scan, its robot scan inside an observation
    window, and its true pose. True landmarks are omitted: no robot uses their IDs. Robots and
    sensors have independent noise.
    """
    sources: list[Iterator[Record | None]] = []
    for robot, sigma, robot_rng in zip(world.robots, settings.sigmas, rng.spawn(2)):
        scan_rng, robot_scan_rng = robot_rng.spawn(2)
        sources += [
            odometry(robot, world.commands[robot], sigma, world.stamps),
            scans(world, robot, scanner, scan_rng),
            robot_scans(world, robot, settings, scanner, robot_scan_rng),
            true_poses(world, robot)]
    for at_stamp in zip(*sources):
        yield from (record for record in at_stamp if record is not None)


def scans(
    world: RendezvousWorld, robot: str, scanner: ScannerSettings, rng: np.random.Generator
) -> Iterator[Scan]:
    """Yield a scan at each stamp, in the order of the robot's own landmark IDs."""
    own_ids = [*world.landmark_of[robot]]
    points = np.array([world.landmarks[true_id] for true_id in world.landmark_of[robot].values()])
    for stamp, pose in zip(world.stamps, world.true_poses[robot]):
        yield Scan(robot, stamp, tuple(
            Observation(own_ids[i], z, R) for i, z, R in observe(pose, points, scanner, rng)))


def robot_scans(
    world: RendezvousWorld, robot: str, settings: RendezvousSettings, scanner: ScannerSettings,
    rng: np.random.Generator,
) -> Iterator[RobotScan | None]:
    """Yield the robot scan at each stamp, None outside of the robot's observation windows."""
    robots = world.robots
    windows = [window for window in settings.windows if robots[window.observer] == robot]
    for k, stamp in enumerate(world.stamps):
        targets = [robots[w.observed] for w in windows if w.first <= k <= w.last]
        if not targets:
            yield None
            continue
        points = np.array([world.true_poses[target][k, :2] for target in targets])
        observed = observe(world.true_poses[robot][k], points, scanner, rng)
        yield RobotScan(
            robot, stamp, tuple(RobotObservation(targets[i], z, R) for i, z, R in observed))


def observe(
    pose: Array, points: Array, scanner: ScannerSettings, rng: np.random.Generator
) -> Iterator[tuple[int, Array, Array]]:
    """
    Yield index, z and R of each of the points (n, 2) that is observed from a pose.

    R is to first order, eq. (14) with the second rotation transposed. A point whose noisy range is
    not positive is not observed.
    """
    z_true = (points - pose[:2]) @ rotation(pose[2])
    for i in in_view(z_true, scanner.range, scanner.field_of_view).tolist():
        true = np.hypot(*z_true[i]), np.arctan2(*z_true[i, ::-1])
        r, beta = rng.normal(true, scanner.polar_sigma)
        if r > 0.0:
            C = rotation(beta)
            root = C * [scanner.polar_sigma[0], r * scanner.polar_sigma[1]]
            yield i, r * C[:, 0], root @ root.T
