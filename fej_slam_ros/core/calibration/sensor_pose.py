# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether a sensor is where and as its observations say: its pose on the robot, handedness and time.

Landmarks stand still. Two observations of one landmark therefore agree after the motion between
them by odometry, over a second or two, unless the sensor is elsewhere, its frame is left-handed or
does not move with the robot, its bearings are wrong, or its stamps are early or late. Each of
these is fitted by itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from fej_slam_ros.core.calibration.shown_errors import blocks, MIN_BLOCKS
from fej_slam_ros.core.geometry import Array, poses_at, rotation, Stamps, wrap
from fej_slam_ros.core.records import NO_ID, NS, Odometry, Scan

#: Time between the two observations of a pair [ns]: odometry is still exact.
PAIR_TIME = 3 * NS // 2
#: Longest time [ns] and distance [m] in which a landmark without ID is followed.
MAX_FOLLOW_TIME, MAX_FOLLOW_DISTANCE = NS // 2, 0.4
#: Minimum number of pairs, and the largest number that is used.
MIN_OBSERVATION_PAIRS, MAX_OBSERVATION_PAIRS = 60, 2_000
#: Error of odometry between the observations of a pair [m].
PAIR_ODOMETRY_SIGMA = 0.02
#: Error of a sensor pose [m, m, rad] that is large, and the weight for each pair of the prior that
#: keeps the pose near the given one where the motion does not determine it: on circles about one
#: centre, turns about it change nothing.
POSE_SCALE, WEIGHT = np.array([0.5, 0.5, 0.5]), 0.2
#: Minimum mean square change of the normalised differences by such an error; with less, the motion
#: does not determine the pose.
MIN_WEIGHT = 0.1
#: Largest error of stamps that is looked for [s].
MAX_STAMP_ERROR = 0.5
#: Minimum share of ranges that must fit the motion where only bearings are wrong, maximum share
#: where they are those of other pairs, and maximum mean resultant length of the changes of such
#: bearings. In MRCLAM set 6, where robots often rest, it is 1.00, and at most 0.57 in degrees.
RANGES_FIT, RANGES_DIFFER, BEARINGS_DIFFER = 0.95, 0.7, 0.6


@dataclass(frozen=True, slots=True, eq=False)
class SensorFit:
    """
    How well pairs of observations agree under each assumption, 1 for the noise that they claim.

    The values are root median squared distances divided by that of a chi-square distribution of
    two degrees of freedom.

    """

    pairs: int  #: number of pairs of observations
    as_given: float  #: agreement with the pose and the stamps of the sensor as they are
    moved: float  #: agreement with another pose
    #: (3,) array, this pose of the frame of the observations in the base frame [m, m, rad]
    pose: Array
    is_determined: bool  #: whether the motion determines it: not on circles about one centre
    delayed: float  #: agreement with other stamps
    delay: float  #: by which these are later than those given [s]
    delay_sigmas: float  #: gain by this delay, in standard errors of the gain
    mirrored: float  #: agreement with left and right exchanged, at the best pose
    still: float  #: agreement without any motion: in map, or of what moves with the robot
    bearings_differ: bool  #: whether the ranges of pairs agree, but not at all their bearings


def fit_sensor(odometry: Sequence[Odometry], scans: Sequence[Scan]) -> SensorFit | None:
    """
    Return how observations of landmarks agree with the odometry of their robot, both by stamps.

    None if there are too few pairs of observations while odometry was there.

    """
    pairs = observation_pairs(odometry, scans, PAIR_TIME)
    if len(pairs.sigma) < MIN_OBSERVATION_PAIRS:
        return None
    given = pairs.at_odometry(0.0)
    pose, none = given.fitted(), np.zeros(3)
    delay = float(minimize_scalar(
        lambda delay: pairs.at_odometry(delay).agreement(none),
        bounds=(-MAX_STAMP_ERROR, MAX_STAMP_ERROR), method='bounded').x)
    delayed, as_given = pairs.at_odometry(delay), given.agreement(none)
    mirrored = replace(pairs, z=pairs.z * [1.0, -1.0]).at_odometry(0.0)
    return SensorFit(
        len(pairs.sigma), as_given, given.agreement(pose), pose,
        given.is_determined(pose), delayed.agreement(none), delay,
        _sigmas(given.costs(as_given) - delayed.costs(as_given), pairs.stamps[0]),
        mirrored.agreement(mirrored.fitted()), pairs.still().agreement(none),
        given.bearings_differ())


def _sigmas(gains: Array, stamps: Stamps) -> float:
    """Return gains (n,), which depend within blocks of time, in standard errors; 0 if few."""
    of_blocks = np.bincount(blocks(stamps), gains)
    if len(of_blocks) < MIN_BLOCKS:
        return 0.0
    # A gain is that of an error squared, so that a few sharp turns would count for all.
    roots = np.sign(of_blocks) * np.sqrt(np.abs(of_blocks))
    spread = np.sqrt(np.sum((roots - roots.mean()) ** 2))
    return float(roots.sum() / spread) if spread > 0.0 else 0.0  # no spread: it stands still


def trajectory(odometry: Sequence[Odometry]) -> tuple[Stamps, Array]:
    """Return the stamps (n,) [ns] of odometry in order, each once, and the poses (n, 3)."""
    stamps = np.array([record.stamp for record in odometry], np.int64)
    poses = np.array([record.pose for record in odometry]).reshape(-1, 3)
    stamps, first = np.unique(stamps, return_index=True)
    return stamps, poses[first]


def observation_pairs(
    odometry: Sequence[Odometry], scans: Sequence[Scan], apart: int
) -> 'ObservationPairs':
    """
    Return observations with those of the same landmarks in the latest scan up to a time later.

    That time is `apart` [ns]. There are about `MAX_OBSERVATION_PAIRS` pairs at most.

    """
    known, poses = trajectory(odometry)
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
        np.sqrt(variances + PAIR_ODOMETRY_SIGMA**2), known, poses)


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


@dataclass(frozen=True, slots=True, eq=False)
class ObservationPairs:
    """n pairs of observations of one landmark each, and the odometry of the robot."""

    stamps: Stamps  #: (2, n) array [ns]
    z: Array  #: (2, n, 2) array [m]
    sigma: Array  #: (n,) array, standard deviation of a difference of both [m]
    known: Stamps  #: (k,) array, stamps of odometry [ns]
    poses: Array  #: (k, 3) array, odometry

    def at_odometry(self, delay: float) -> '_PlacedPairs':
        """Return the pairs with the poses of the robot, for stamps late by a delay [s]."""
        p, q = self.z
        first, second = (
            poses_at(stamps - round(delay * NS), self.known, self.poses) for stamps in self.stamps)
        return _PlacedPairs(
            p, q, rotations(first[:, 2]), rotations(second[:, 2]),
            first[:, :2] - second[:, :2], self.sigma)

    def still(self) -> '_PlacedPairs':
        """Return the pairs with a robot that does not move."""
        p, q = self.z
        unturned = rotations(np.zeros(len(p)))
        return _PlacedPairs(p, q, unturned, unturned, np.zeros_like(p), self.sigma)


@dataclass(frozen=True, slots=True, eq=False)
class _PlacedPairs:
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
        of_first = np.einsum('nij,nj->ni', self.A, self.p @ C.T + pose[:2])
        of_second = np.einsum('nij,nj->ni', self.B, self.q @ C.T + pose[:2])
        normalised: Array = (of_first - of_second + self.motion) / self.sigma[:, None]
        return normalised

    def jacobian(self, pose: Array) -> Array:
        """Return the derivatives (n, 2, 3) of the normalised differences."""
        D = rotation(pose[2] + np.pi / 2.0)
        turned = np.einsum('nij,nj->ni', self.A, self.p @ D.T) - np.einsum(
            'nij,nj->ni', self.B, self.q @ D.T)
        J = np.concatenate([self.A - self.B, turned[:, :, None]], axis=2)
        return J / self.sigma[:, None, None]

    def agreement(self, pose: Array) -> float:
        """Return the root median squared distance, 1 for the claimed noise."""
        squared = np.sum(self.residuals(pose) ** 2, axis=1)
        return float(np.sqrt(np.median(squared) / (2.0 * np.log(2.0))))

    def costs(self, scale: float) -> Array:
        """Return the robust loss (n,) of the differences as given, for a scale of their noise."""
        squared = np.sum(self.residuals(np.zeros(3)) ** 2, axis=1)
        costs: Array = np.sqrt(1.0 + squared / scale ** 2)
        return costs

    def is_determined(self, pose: Array) -> bool:
        """Return whether a change of each part of a pose (3,) changes the differences."""
        J = self.jacobian(pose).reshape(-1, 3) * POSE_SCALE
        return float(np.linalg.eigvalsh(J.T @ J)[0]) > MIN_WEIGHT * len(J)

    def bearings_differ(self) -> bool:
        """Return whether the ranges of pairs fit the motion, but not at all their bearings."""
        first, second = np.hypot(*self.p.T), np.hypot(*self.q.T)
        limit = np.hypot(*self.motion.T) + 3.0 * self.sigma
        fit, others_fit = (
            np.mean(np.abs(first - ranges) <= limit)
            for ranges in (second, np.roll(second, len(second) // 2)))
        expected = np.einsum('nij,nj->ni', self.A, self.p) + self.motion
        turned = np.einsum('nij,nj->ni', self.B, self.q)
        change = np.arctan2(*turned.T) - np.arctan2(*expected.T)
        return bool(
            fit >= RANGES_FIT and others_fit <= RANGES_DIFFER
            and abs(np.mean(np.exp(1j * change))) <= BEARINGS_DIFFER)

    def fitted(self) -> Array:
        """Return the pose (3,) of the frame of observations under which pairs agree best."""
        # One small residual for each pair stays in the quadratic part of the robust loss.
        prior = np.tile(WEIGHT * np.diag(1.0 / POSE_SCALE), (len(self.sigma), 1))

        def residuals(pose: Array) -> Array:
            return np.append(self.residuals(pose).ravel(), prior @ pose)

        def jacobian(pose: Array) -> Array:
            return np.vstack([self.jacobian(pose).reshape(-1, 3), prior])

        best = min(
            (least_squares(residuals, np.array([0.0, 0.0, yaw]), jacobian, loss='soft_l1')
             for yaw in np.arange(4) * np.pi / 2.0), key=lambda fit: float(fit.cost))
        x, y, yaw = best.x
        return np.array([x, y, wrap(yaw)])


def rotations(angles: Array) -> Array:
    """Return rotation matrices (n, 2, 2) of angles (n,) [rad]."""
    c, s = np.cos(angles), np.sin(angles)
    return np.moveaxis(np.array([[c, -s], [s, c]]), 2, 0)
