# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Noise scale factors from errors against ground truth.

Odometry errors are those of the relative pose over a window: errors of wheels and gyros are
correlated over more than one message, so that single increments would give too small a factor.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
import math

import numpy as np
from scipy.special import chdtr, chdtri

from fej_slam_ros.core import models
from fej_slam_ros.core.consistency import is_definite, nees, pose_error
from fej_slam_ros.core.geometry import Array, between, compose, interpolated
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.odometry_increments import increment
from fej_slam_ros.core.records import (
    NS, Observation, Odometry, Record, RobotObservation, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import NoiseSettings, Settings

#: Degrees of freedom of an error by kind of noise, as in the parameters ``<kind>_noise_scale``.
DOF = {'odometry': 3, 'landmark': 2, 'robot': 2}

#: Length [ns] of the window of an odometry error, and the longest one between sparse true poses.
ODOMETRY_WINDOW, MAX_ODOMETRY_WINDOW = 5 * NS, 60 * NS

#: Time [ns] from a sparse true pose within which odometry leads to others; its error is small
#: against that of an observation.
NEAR = NS // 4

#: Tail probability beyond which an error is an outlier. The limit of a gate would cut the heavy
#: tails of real noise, and so give factors that are too small.
OUTLIER_PROBABILITY = 1e-6

#: Largest standard error of a usable factor of the team, and of one of a single robot, relative.
MAX_RELATIVE_ERROR = 0.15
MAX_OWN_ERROR = 0.05


@dataclass(frozen=True, slots=True)
class NoiseScale:
    """Factor on stated standard deviations."""

    scale: float  #: the factor
    relative_error: float  #: standard error of its logarithm, for independent errors
    samples: int  #: number of errors or innovations

    def is_known(self) -> bool:
        """Return whether there was enough data."""
        return self.relative_error <= MAX_RELATIVE_ERROR


#: Normalised errors squared, e^T P^-1 e, of one kind by robot.
Errors = Mapping[str, Sequence[float]]


def noise_scale(squared: Sequence[float], dof: int) -> NoiseScale:
    """
    Return the root mean error squared e^T P^-1 e per degree of freedom, without outliers.

    Iterated from the median; the mean of the inliers is compared with that of the chi-square
    distribution truncated at the same limit.

    """
    d2 = np.array(squared)
    limit = chdtri(dof, OUTLIER_PROBABILITY)
    truncated_mean = dof * chdtr(dof + 2, limit) / chdtr(dof, limit)
    variance, kept = float(np.median(d2)) / chdtri(dof, 0.5), 0
    while (count := int((d2 <= limit * variance).sum())) > kept:
        variance, kept = float(d2[d2 <= limit * variance].mean()) / truncated_mean, count
    return NoiseScale(math.sqrt(variance), 1.0 / math.sqrt(2 * dof * len(d2)), len(d2))


def noise_scales(errors: Errors, dof: int) -> dict[str, NoiseScale]:
    """Return the factor of the team under '', and those of robots with enough data."""
    own = {robot: noise_scale(squared, dof) for robot, squared in errors.items() if squared}
    pooled = noise_scale([d2 for squared in errors.values() for d2 in squared], dof)
    return {'': pooled} | {
        robot: found for robot, found in own.items() if found.relative_error <= MAX_OWN_ERROR}


def normalized_errors(records: Iterable[Record], settings: Settings) -> dict[str, Errors]:
    """
    Return the normalised errors squared of each kind of noise with ground truth.

    The settings give the noise of measurements without covariance, and systematic errors of
    odometry; noise scales are not used.

    """
    records = list(records)
    truth = RecordedTruth()
    for record in records:
        if isinstance(record, (TruePose, TrueLandmarks)):
            truth.add(record)
    if not settings.shared_landmark_ids:
        # Which robot's IDs the true landmarks have is unknown.
        truth.landmarks.clear()
    errors: dict[str, dict[str, list[float]]] = {
        kind: {robot.name: [] for robot in settings.robots} for kind in DOF}
    near = {}
    for robot in settings.robots:
        odometry = sorted(
            (r for r in records if isinstance(r, Odometry) and r.robot == robot.name),
            key=lambda record: record.stamp)
        errors['odometry'][robot.name] += _odometry_errors(odometry, truth, robot)
        near[robot.name] = NearTruth(truth, robot.name, odometry)
    for scan in records:
        if isinstance(scan, (Scan, RobotScan)) and scan.robot in near:
            kind = 'robot' if isinstance(scan, RobotScan) else 'landmark'
            errors[kind][scan.robot] += _observation_errors(scan, truth, near)
    return {kind: by_robot for kind, by_robot in errors.items() if any(by_robot.values())}


def _odometry_errors(
    odometry: Sequence[Odometry], truth: RecordedTruth, settings: NoiseSettings
) -> Iterator[float]:
    """Yield the normalised error squared of each window between known true poses."""
    begin, x, P = None, np.zeros(3), np.zeros((3, 3))
    for earlier, later in pairwise(odometry):
        if begin is None or later.stamp - begin.stamp > MAX_ODOMETRY_WINDOW:
            if not truth.covers(earlier.robot, earlier.stamp):
                continue
            begin, x, P = earlier, np.zeros(3), np.zeros((3, 3))
        u, Q = increment(earlier, later, settings)
        G = models.G(x[2])
        Phi = models.Phi(G[:2, :2] @ u[:2])
        x, P = compose(x, u), Phi @ P @ Phi.T + G @ Q @ G.T
        if later.stamp - begin.stamp >= ODOMETRY_WINDOW and truth.covers(
                later.robot, later.stamp):
            if is_definite(P):
                true = between(*(truth.pose(end.robot, end.stamp) for end in (begin, later)))
                yield float(nees(pose_error(x, true), P))
            begin, x, P = later, np.zeros(3), np.zeros((3, 3))


class NearTruth:
    """True poses of a robot, also near sparse ones: odometry leads there."""

    def __init__(
        self, truth: RecordedTruth, robot: str, odometry: Sequence[Odometry]
    ) -> None:
        self._truth, self._robot, self._odometry = truth, robot, odometry
        self._isolated = truth.isolated(robot)

    def pose(self, stamp: int) -> Array | None:
        """Return the pose at a stamp [ns], a (3,) array, None if it is not known."""
        true = self._truth.find(self._robot, stamp)
        if true is not None:
            return true
        after = bisect_left(self._isolated, stamp)
        near = [s for s in self._isolated[max(after - 1, 0):after + 1] if abs(s - stamp) <= NEAR]
        if not near:
            return None
        known = min(near, key=lambda s: abs(s - stamp))
        begin, end = self._odometry_at(known), self._odometry_at(stamp)
        if begin is None or end is None:
            return None
        return compose(self._truth.pose(self._robot, known), between(begin, end))

    def _odometry_at(self, stamp: int) -> Array | None:
        after = bisect_left(self._odometry, stamp, key=lambda record: record.stamp)
        if not 0 < after < len(self._odometry):
            return None
        earlier, later = self._odometry[after - 1], self._odometry[after]
        fraction = (stamp - earlier.stamp) / (later.stamp - earlier.stamp)
        return interpolated(earlier.pose, later.pose, fraction)


def _observation_errors(
    scan: Scan | RobotScan, truth: RecordedTruth, near: Mapping[str, NearTruth]
) -> Iterator[float]:
    """Yield the normalised error squared of each observation whose true position is known."""
    pose = near[scan.robot].pose(scan.stamp)
    if pose is None:
        return
    for o in scan.observations:
        point = truth.landmarks.get(o.id) if isinstance(o, Observation) else None
        if isinstance(o, RobotObservation) and o.observed in near:
            point = near[o.observed].pose(scan.stamp)
        if point is not None:
            yield float(nees(o.z - models.h(pose[None], point[None, :2])[0], o.R))
