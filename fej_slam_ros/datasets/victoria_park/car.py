# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
What the car of Victoria Park measured, as records of one robot or of the two of [Liu].

The base frame is in the middle of the rear axle; ``map`` is that of GPS, x east and y north. One
robot has the whole log on its own clock. Two have the parts of it that [Liu] gave them; the stamps
of the second are shifted so that both set out together.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from heapq import merge
from itertools import islice, repeat
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, wrap_all
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.core.records import GpsFix, NS, Observation, Odometry, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings, Triple
from fej_slam_ros.datasets.victoria_park import gps
from fej_slam_ros.datasets.victoria_park.raw_log import MS, RawLog, Wheels
from fej_slam_ros.errors import UserError

#: The car [m]: its wheel base, and how far left of the axle's middle the encoder's wheel is.
L = 2.83
H = 0.76
#: Where the laser is in the base frame [m, m, rad].
LASER: Array = np.array([3.78, 0.50, 0.0])

#: A way of t seconds, d metres and a turn of theta has the variances FLOOR^2 t + SLIP^2 d +
#: TURN^2 theta of x, y and heading [m, m, rad].
FLOOR: Array = np.array([0.01, 0.01, 0.001])
SLIP: Array = np.array([0.025, 0.03, 0.005])
TURN: Array = np.array([0.0, 0.0, 0.1])
#: Standard deviations of a detection [m, rad].
SIGMA_RANGE = 0.09
SIGMA_BEARING = 0.0035
#: Standard deviations of a fix of GPS [m], as a rule and where it is doubted.
SIGMA_FIX = 1.5
SIGMA_DOUBTED = 1e3
#: Standard deviations of where GPS has a robot start, seen from where it has another [m, m, rad].
START_SIGMA: Triple = (3.0, 3.0, 0.1)

#: First and last scan [ms] of each robot by their number; None is the whole log.
TEAMS: Mapping[int, Mapping[str, tuple[int, int] | None]] = {
    1: {'r1': None},
    2: {'r1': (187_382, 736_197), 'r2': (736_410, 1_310_861)},
}
#: When the first scan of each is said to be [ms].
SET_OUT = 187_382


Measured = Odometry | Scan | GpsFix


@dataclass(frozen=True, slots=True, eq=False)
class CarDrive:
    """
    What one robot measured.

    Attributes
    ----------
    log : its part of the log
    poses : (n, 3) array, where the wheels have it at their stamps, from the origin on
    start : (3,) array, where in ``map`` that origin is, by GPS
    is_doubted : (g,) array, the fixes of GPS that are not to be believed

    """

    log: RawLog
    poses: Array
    start: Array
    is_doubted: Flags


def drives(log: RawLog, robots: int) -> dict[str, CarDrive]:
    """
    Return the drive of each robot of a team.

    Raises
    ------
    UserError
        The log is too short for the team, or GPS does not tell where a robot starts.

    """
    return {
        robot: _drive(log if scans is None else _part(log, robot, *scans))
        for robot, scans in TEAMS[robots].items()}


def way(wheels: Wheels) -> Array:
    """Return where speed and steering take the car (n, 3), on an arc from stamp to stamp."""
    _, d, theta = _arcs(wheels)
    chord = d * np.sinc(theta / (2.0 * np.pi))
    phi = np.append(0.0, np.cumsum(theta))
    along = phi[:-1] + theta / 2.0
    steps = np.column_stack([chord * np.cos(along), chord * np.sin(along)])
    points = np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])
    return np.column_stack([points, wrap_all(phi)])


def twist_covariances(wheels: Wheels) -> Array:
    """Return the covariance (n - 1, 3, 3) of the mean velocity from each stamp to the next."""
    dt, d, theta = _arcs(wheels)
    variances = (
        np.outer(dt, FLOOR**2) + np.outer(np.abs(d), SLIP**2) + np.outer(np.abs(theta), TURN**2))
    covariances: Array = (variances / dt[:, None] ** 2)[:, :, None] * np.eye(3)
    return covariances


def records(team: Mapping[str, CarDrive]) -> Iterator[Measured]:
    """Return the records of all robots in the order of stamps."""
    streams: list[Iterator[Measured]] = []
    for robot, drive in team.items():
        streams += _odometry(robot, drive), _scans(robot, drive), _fixes(robot, drive)
    return merge(*streams, key=lambda record: record.stamp)


def settings(team: Mapping[str, CarDrive]) -> Settings:
    """Return the settings of a run; the noise comes with the records."""
    (anchor, first), *others = team.items()
    robots = [RobotSettings(anchor, 1)]
    for number, (robot, drive) in enumerate(others, start=2):
        robots.append(RobotSettings(robot, number, _triple(drive.start), START_SIGMA))
    return Settings(tuple(robots), anchor, _triple(first.start))


def _part(log: RawLog, robot: str, first: int, last: int) -> RawLog:
    """Return the log from one scan to another [ms], as if the first had been at `SET_OUT`."""
    begin, end = (stamp / MS for stamp in log.wheels.stamps[[0, -1]].tolist())
    if not begin <= first < last <= end:
        raise UserError(
            f'the wheels went from {begin / 1e3} to {end / 1e3} s, but robot {robot} needs'
            f' {first / 1e3} to {last / 1e3} s: take the whole log, or one robot')
    return log.between(first * MS, last * MS).later((SET_OUT - first) * MS)


def _drive(log: RawLog) -> CarDrive:
    poses = way(log.wheels)
    there = gps.antenna_points(log.fixes.stamps, log.wheels.stamps, poses)
    is_doubted = gps.doubted(log.fixes, there)
    return CarDrive(log, poses, gps.begin(log.fixes, there, is_doubted), is_doubted)


def _arcs(wheels: Wheels) -> tuple[Array, Array, Array]:
    """Return the durations [s], lengths [m] and turns [rad] from each stamp to the next."""
    dt = np.diff(wheels.stamps) / NS
    turn = np.tan(wheels.steering[:-1])
    d = wheels.speed[:-1] / (1.0 - turn * H / L) * dt
    return dt, d, d * turn / L


def _odometry(robot: str, drive: CarDrive) -> Iterator[Odometry]:
    wheels = drive.log.wheels
    covariances = [None, *twist_covariances(wheels)]
    return map(Odometry, repeat(robot), wheels.stamps.tolist(), drive.poses, covariances)


def _scans(robot: str, drive: CarDrive) -> Iterator[Scan]:
    scans = drive.log.scans
    seen = map(_observation, scans.ids.tolist(), scans.ranges.tolist(), scans.bearings.tolist())
    for stamp, count in zip(scans.stamps.tolist(), np.diff(scans.starts).tolist()):
        yield Scan(robot, stamp, tuple(islice(seen, count)))


def _observation(number: int, r: float, bearing: float) -> Observation:
    """Return a detection in the base frame; the laser counts bearings from its right."""
    z, R = polar(r, bearing - math.pi / 2.0 + LASER[2], SIGMA_RANGE, SIGMA_BEARING)
    return Observation(number, LASER[:2] + z, R)


def _fixes(robot: str, drive: CarDrive) -> Iterator[GpsFix]:
    sigmas = np.where(drive.is_doubted, SIGMA_DOUBTED, SIGMA_FIX)
    covariances = sigmas[:, None, None] ** 2 * np.eye(2)
    fixes = drive.log.fixes
    return map(GpsFix, repeat(robot), fixes.stamps.tolist(), fixes.points, covariances)


def _triple(pose: Array) -> Triple:
    x, y, phi = pose.tolist()
    return x, y, phi
