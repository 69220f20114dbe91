# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pairs of observations of one landmark each, and the motion of the robot between both.

Landmarks stand still: the two observations agree after the motion by odometry.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.calibration.odometry_trajectory import OdometryTrajectory
from fej_slam_ros.core.geometry import Array, products, rotation, rotations, Stamps
from fej_slam_ros.core.records import NO_ID, NS, Odometry, Scan

#: Longest time [ns] and distance [m] in which a landmark without ID is followed.
MAX_FOLLOW_TIME, MAX_FOLLOW_DISTANCE = NS // 2, 0.4
#: The largest number of pairs that is used.
MAX_OBSERVATION_PAIRS = 2_000
#: Error of odometry between the observations of a pair [m].
PAIR_ODOMETRY_SIGMA = 0.02
#: Largest error of stamps that is looked for [s].
MAX_STAMP_ERROR = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ObservationPairs:
    """n pairs of observations of one landmark each, and the odometry of the robot."""

    stamps: Stamps  #: (2, n) array [ns]
    z: Array  #: (2, n, 2) array [m]
    sigma: Array  #: (n,) array, standard deviation of a difference of both [m]
    odometry: OdometryTrajectory

    def at_odometry(self, delay: float) -> 'PlacedPairs':
        """Return the pairs with the poses of the robot, for stamps late by a delay [s]."""
        p, q = self.z
        first, second = (
            self.odometry.at(stamps - round(delay * NS)) for stamps in self.stamps)
        return PlacedPairs(
            p, q, rotations(first[:, 2]), rotations(second[:, 2]),
            first[:, :2] - second[:, :2], self.sigma)

    def still(self) -> 'PlacedPairs':
        """Return the pairs with a robot that does not move."""
        p, q = self.z
        unturned = rotations(np.zeros(len(p)))
        return PlacedPairs(p, q, unturned, unturned, np.zeros_like(p), self.sigma)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPairs:
    """n pairs of observations p and q (n, 2), the rotations A and B (n, 2, 2) of the robot."""

    p: Array
    q: Array
    A: Array
    B: Array
    motion: Array  #: (n, 2) array, position at the first observation minus that at the second [m]
    sigma: Array  #: (n,) array [m]

    def residuals(self, pose: Array) -> Array:
        """Return the normalised differences (n, 2) for a pose (3,) of the sensor."""
        C = rotation(pose[2])
        of_first = products(self.A, self.p @ C.T + pose[:2])
        of_second = products(self.B, self.q @ C.T + pose[:2])
        normalised: Array = (of_first - of_second + self.motion) / self.sigma[:, None]
        return normalised

    def jacobian(self, pose: Array) -> Array:
        """Return the derivatives (n, 2, 3) of the normalised differences."""
        D = rotation(pose[2] + np.pi / 2.0)
        turned = products(self.A, self.p @ D.T) - products(self.B, self.q @ D.T)
        J = np.concatenate([self.A - self.B, turned[:, :, None]], axis=2)
        return J / self.sigma[:, None, None]


def observation_pairs(
    odometry: Sequence[Odometry], scans: Sequence[Scan], apart: int
) -> ObservationPairs:
    """
    Return observations with those of the same landmarks in the latest scan up to a time later.

    That time is `apart` [ns]. There are about `MAX_OBSERVATION_PAIRS` pairs at most.

    """
    trajectory = OdometryTrajectory.of(odometry)
    known = trajectory.stamps
    margin = round(MAX_STAMP_ERROR * NS)
    inside = [*_identified([
        scan for scan in scans if len(known)
        and known[0] + margin < scan.stamp < known[-1] - margin])]
    times = np.array([scan.stamp for scan in inside], np.int64)
    rows = [
        (scan.stamp, other.stamp, scan.z[id_], other.z[id_],
         scan.variance[id_] + other.variance[id_])
        for scan in inside
        for other in [inside[int(np.searchsorted(times, scan.stamp + apart, 'right')) - 1]]
        if other.stamp > scan.stamp for id_ in scan.z.keys() & other.z.keys()]
    rows = rows[::max(1, len(rows) // MAX_OBSERVATION_PAIRS)]
    variances = np.array([row[4] for row in rows])
    return ObservationPairs(
        np.array([row[:2] for row in rows], np.int64).reshape(-1, 2).T,
        np.array([row[2:4] for row in rows]).reshape(-1, 2, 2).transpose(1, 0, 2),
        np.sqrt(variances + PAIR_ODOMETRY_SIGMA**2), trajectory)


class _Identified(NamedTuple):
    """The observations of a scan by an identity that lasts over scans."""

    stamp: int
    z: dict[int, Array]
    variance: dict[int, float]  #: mean of the variances of both coordinates [m^2]


def _identified(scans: Sequence[Scan]) -> Iterator[_Identified]:
    """Yield the scans; landmarks without ID are followed from scan to scan by their places."""
    before, last, new_identities = np.empty((0, 2)), 0, count(NO_ID - 1, -1)
    identities: list[int] = []
    for scan in scans:
        known = {s.id: s for s in scan.observations if s.id != NO_ID}
        unknown = [s for s in scan.observations if s.id == NO_ID]
        points = np.array([s.z for s in unknown]).reshape(-1, 2)
        if scan.stamp - last > MAX_FOLLOW_TIME:
            before, identities = np.empty((0, 2)), []
        found = _followed(before, points)
        identities = [next(new_identities) if k is None else identities[k] for k in found]
        before, last = points, scan.stamp
        seen = known | dict(zip(identities, unknown))
        yield _Identified(
            scan.stamp, {id_: s.z for id_, s in seen.items()},
            {id_: float(np.trace(s.R)) / 2.0 for id_, s in seen.items()})


def _followed(before: Array, points: Array) -> list[int | None]:
    """Return for each point (m, 2) the one before (n, 2) that is the nearest, and vice versa."""
    if not len(before) or not len(points):
        return [None] * len(points)
    distances = np.hypot(*(points[:, None] - before).transpose(2, 0, 1))
    nearest, back = distances.argmin(axis=1), distances.argmin(axis=0)
    return [
        int(k) if back[k] == index and distances[index, k] < MAX_FOLLOW_DISTANCE else None
        for index, k in enumerate(nearest)]
