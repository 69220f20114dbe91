# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The raw log of Victoria Park as records of one robot, or of the two of [Liu].

The base frame is in the middle of the rear axle; ``map`` is the frame of GPS, x east and y north.
One robot has the whole log with its own stamps. Two robots have the parts that [Liu] assigned to
them; the stamps of the second are shifted so that both start together.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from heapq import merge
from itertools import islice, repeat
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.motion_models import arc_poses, polar
from fej_slam_ros.core.records import GpsFix, NS, Observation, Odometry, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings, Triple
from fej_slam_ros.datasets.series import Series
from fej_slam_ros.datasets.victoria_park import gps
from fej_slam_ros.datasets.victoria_park.raw_log import MS, RawLog
from fej_slam_ros.errors import UserError

#: Wheel base of the car, and distance of the encoder wheel to the left of the axle's middle [m].
WHEEL_BASE = 2.83
ENCODER_OFFSET = 0.76
#: Pose of the laser in the base frame [m, m, rad].
LASER: Array = np.array([3.78, 0.50, 0.0])
#: An increment of t seconds, d metres and theta radians has the variances DRIFT_SIGMA^2 t +
#: SLIP_SIGMA^2 d + TURN_SIGMA^2 theta of x, y and heading [m^2, m^2, rad^2].
DRIFT_SIGMA: Array = np.array([0.01, 0.01, 0.001])
SLIP_SIGMA: Array = np.array([0.025, 0.03, 0.005])
TURN_SIGMA: Array = np.array([0.0, 0.0, 0.1])
#: In a gap of t seconds, longer than MAX_WHEEL_HOLD [s], speed and steering change: the variances
#: grow by (GAP_SIGMA t^2)^2 [m/s^2, m/s^2, rad/s^2], measured with rows left out of the log.
MAX_WHEEL_HOLD = 0.2
GAP_SIGMA: Array = np.array([0.16, 0.16, 0.03])
#: Standard deviations of a detection [m, rad].
SIGMA_RANGE = 0.09
SIGMA_BEARING = 0.0035
#: Standard deviations of a GPS fix [m]: regular, and for an outlier.
SIGMA_FIX = 1.5
SIGMA_OUTLIER = 1e3
#: Standard deviations of a start pose by GPS relative to that of the anchor [m, m, rad].
GPS_START_SIGMA: Triple = (3.0, 3.0, 0.1)
#: Time of the first and the last scan [ms] of each robot, by the size of the team; None is the
#: whole log.
RAW_TEAMS: Mapping[int, Mapping[str, tuple[int, int] | None]] = {
    1: {'r1': None},
    2: {'r1': (187_382, 736_197), 'r2': (736_410, 1_310_861)},
}
#: Time to which the first scan of each robot of a team of two is shifted [ms].
COMMON_START = 187_382
Measured = Odometry | Scan | GpsFix


@dataclass(frozen=True, slots=True, eq=False)
class CarDrive:
    """Measurements of one robot."""

    log: RawLog  #: Its part of the log
    poses: Array  #: (n, 3) array, dead reckoning at the stamps of the wheels, from the origin
    start: Array  #: (3,) array, pose of that origin in ``map`` by GPS
    is_outlier: Flags  #: (g,) array, the GPS fixes that are outliers


def drives(log: RawLog, robots: int) -> dict[str, CarDrive]:
    """Return the drive of each robot of a team, which the log and its GPS must cover."""
    return {
        robot: _drive(log if scans is None else _part(log, robot, *scans))
        for robot, scans in RAW_TEAMS[robots].items()}


def dead_reckoning(wheels: Series) -> Array:
    """Return the poses (n, 3) by speed and steering, on an arc from stamp to stamp."""
    _, lengths, turns = _arcs(wheels)
    return arc_poses(lengths, turns)


def twist_covariances(wheels: Series) -> Array:
    """Return the covariance (n - 1, 3, 3) of the mean velocity from each stamp to the next."""
    dt, d, theta = _arcs(wheels)
    variances = (
        np.outer(dt, DRIFT_SIGMA**2) + np.outer(np.abs(d), SLIP_SIGMA**2)
        + np.outer(np.abs(theta), TURN_SIGMA**2)
        + np.outer(np.where(dt > MAX_WHEEL_HOLD, dt, 0.0)**4, GAP_SIGMA**2))
    covariances: Array = (variances / dt[:, None] ** 2)[:, :, None] * np.eye(3)
    return covariances


def records(team: Mapping[str, CarDrive]) -> Iterator[Measured]:
    """Return the records of all robots in the order of stamps."""
    streams: list[Iterator[Measured]] = []
    for robot, drive in team.items():
        streams += _odometry(robot, drive), _scans(robot, drive), _fixes(robot, drive)
    return merge(*streams, key=lambda record: record.stamp)


def settings(team: Mapping[str, CarDrive]) -> Settings:
    """Return the settings of a run; the records carry the noise."""
    (anchor, first), *others = team.items()
    robots = [RobotSettings(anchor, 1), *(
        RobotSettings(robot, id_, _triple(drive.start), GPS_START_SIGMA)
        for id_, (robot, drive) in enumerate(others, start=2))]
    return Settings(tuple(robots), anchor, _triple(first.start))


def _part(log: RawLog, robot: str, first: int, last: int) -> RawLog:
    """Return the log from one scan to another [ms], the first one shifted to `COMMON_START`."""
    begin, end = (stamp / MS for stamp in log.wheels.stamps[[0, -1]].tolist())
    if not begin <= first < last <= end:
        raise UserError(
            f'wheel data reach from {begin / 1e3} to {end / 1e3} s, but robot {robot} needs'
            f' {first / 1e3} to {last / 1e3} s: take the whole log, or one robot')
    return log.between(first * MS, last * MS).shifted((COMMON_START - first) * MS)


def _drive(log: RawLog) -> CarDrive:
    poses = dead_reckoning(log.wheels)
    antenna = gps.antenna_points(log.fixes.stamps, log.wheels.stamps, poses)
    is_outlier = gps.outliers(log.fixes, antenna)
    return CarDrive(log, poses, gps.start_pose(log.fixes, antenna, is_outlier), is_outlier)


def _arcs(wheels: Series) -> tuple[Array, Array, Array]:
    """Return the durations [s], lengths [m] and turns [rad] from each stamp to the next."""
    dt = np.diff(wheels.stamps) / NS
    speed, steering = wheels.rows[:-1].T
    turn = np.tan(steering)
    d = speed / (1.0 - turn * ENCODER_OFFSET / WHEEL_BASE) * dt
    return dt, d, d * turn / WHEEL_BASE


def _odometry(robot: str, drive: CarDrive) -> Iterator[Odometry]:
    wheels = drive.log.wheels
    covariances = [None, *twist_covariances(wheels)]
    return map(Odometry, repeat(robot), wheels.stamps.tolist(), drive.poses, covariances)


def _scans(robot: str, drive: CarDrive) -> Iterator[Scan]:
    trees = drive.log.trees
    observations = map(
        _observation, trees.ids.tolist(), trees.ranges.tolist(), trees.bearings.tolist())
    for stamp, count in zip(trees.stamps.tolist(), np.diff(trees.starts).tolist()):
        yield Scan(robot, stamp, tuple(islice(observations, count)))


def _observation(id_: int, r: float, bearing: float) -> Observation:
    """Return a detection in the base frame; bearings are counted from the laser's right."""
    z, R = polar(r, bearing - math.pi / 2.0 + LASER[2], SIGMA_RANGE, SIGMA_BEARING)
    return Observation(id_, LASER[:2] + z, R)


def _fixes(robot: str, drive: CarDrive) -> Iterator[GpsFix]:
    sigmas = np.where(drive.is_outlier, SIGMA_OUTLIER, SIGMA_FIX)
    covariances = sigmas[:, None, None] ** 2 * np.eye(2)
    fixes = drive.log.fixes
    return map(GpsFix, repeat(robot), fixes.stamps.tolist(), fixes.rows, covariances)


def _triple(pose: Array) -> Triple:
    x, y, phi = pose.tolist()
    return x, y, phi
