# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What scanners of range and bearing see in an encounter, section III-B of [Andersson]."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.core.records import Observation, Record, RobotObservation, RobotScan, Scan
from fej_slam_ros.sim.driving import odometry
from fej_slam_ros.sim.encounters import Encounter, EncounterSettings
from fej_slam_ros.sim.sensors import in_view, true_poses


@dataclass(frozen=True)
class ScannerSettings:
    """
    The scanner of every robot; lengths in m, angles in rad.

    Attributes
    ----------
    field_of_view : full angle around straight ahead in which anything is seen
    polar_sigma : standard deviations of a range and of a bearing
    range : largest true distance at which anything is seen

    """

    field_of_view: float
    polar_sigma: tuple[float, float] = (0.01, 0.012)
    range: float = 4.0


def measure(
    encounter: Encounter, settings: EncounterSettings, scanner: ScannerSettings,
    rng: np.random.Generator,
) -> Iterator[Record]:
    """
    Yield the records of an encounter in the order of stamps.

    At each stamp every robot gives its odometry, its scan, what it sees of the other robot while
    it looks for it, and its true pose. True landmarks are not told: their numbers are no robot's.
    Robots and sensors have unrelated noise.
    """
    sources: list[Iterator[Record | None]] = []
    for robot, sigma, robot_rng in zip(encounter.robots, settings.sigmas, rng.spawn(2)):
        scan_rng, meeting_rng = robot_rng.spawn(2)
        sources += [
            odometry(robot, encounter.commands[robot], sigma, encounter.stamps),
            scans(encounter, robot, scanner, scan_rng),
            robot_scans(encounter, robot, settings, scanner, meeting_rng),
            true_poses(encounter, robot)]
    for at_stamp in zip(*sources):
        yield from (record for record in at_stamp if record is not None)


def scans(
    encounter: Encounter, robot: str, scanner: ScannerSettings, rng: np.random.Generator
) -> Iterator[Scan]:
    """Yield a scan at each stamp, in the order of the robot's own numbers of landmarks."""
    landmark_of = encounter.landmark_of[robot]
    positions = np.array([encounter.landmarks[landmark] for landmark in landmark_of.values()])
    own = [*landmark_of]
    for stamp, pose in zip(encounter.stamps, encounter.true_poses[robot]):
        seen = look(pose, positions, scanner, rng)
        yield Scan(robot, stamp, tuple(Observation(own[i], z, R) for i, z, R in seen))


def robot_scans(
    encounter: Encounter, robot: str, settings: EncounterSettings, scanner: ScannerSettings,
    rng: np.random.Generator,
) -> Iterator[RobotScan | None]:
    """Yield at each stamp what the robot sees of those that it looks for, None of nobody."""
    robots = encounter.robots
    watches = [watch for watch in settings.watches if robots[watch.observer] == robot]
    for k, stamp in enumerate(encounter.stamps):
        looked_for = [robots[w.seen] for w in watches if w.first <= k <= w.last]
        if not looked_for:
            yield None
            continue
        positions = np.array([encounter.true_poses[name][k, :2] for name in looked_for])
        seen = look(encounter.true_poses[robot][k], positions, scanner, rng)
        yield RobotScan(
            robot, stamp, tuple(RobotObservation(looked_for[i], z, R) for i, z, R in seen))


def look(
    pose: Array, points: Array, scanner: ScannerSettings, rng: np.random.Generator
) -> Iterator[tuple[int, Array, Array]]:
    """
    Yield the index of each of some points (n, 2) that is seen from a pose, with its z and R.

    What noise would put behind the scanner is not seen.
    """
    z_true = (points - pose[:2]) @ rotation(pose[2])
    for i in in_view(z_true, scanner.range, scanner.field_of_view).tolist():
        true = np.hypot(*z_true[i]), np.arctan2(*z_true[i, ::-1])
        r, beta = rng.normal(true, scanner.polar_sigma)
        if r > 0.0:
            yield i, *polar(r, beta, *scanner.polar_sigma)
