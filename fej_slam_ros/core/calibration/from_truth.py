# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Noise scale factors from errors against ground truth.

Errors are those over a window: of odometry, of the relative pose; of observations, the sum of the
errors with which a robot observes one landmark or robot. Errors of wheels, gyros and detectors
persist for longer than a message, so that single ones would give too small a factor.
"""

from bisect import bisect_left
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, pairwise
import math
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from scipy.special import chdtr, chdtri

from fej_slam_ros.core import models
from fej_slam_ros.core.consistency import nees, pose_error
from fej_slam_ros.core.definiteness import is_definite
from fej_slam_ros.core.geometry import Array, between, compose, interpolated
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.ordering.odometry_increments import increment
from fej_slam_ros.core.records import (
    NS, Observation, Odometry, Record, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import NoiseSettings, Settings

#: Degrees of freedom of an error by kind of noise, as in the parameters ``<kind>_noise_scale``.
DOF = {'odometry': 3, 'landmark': 2, 'robot': 2}

#: Length [ns] of the window of an error, and the longest one between sparse true poses.
ERROR_WINDOW, MAX_ODOMETRY_WINDOW = 5 * NS, 60 * NS

#: Time [ns] from a sparse true pose within which odometry leads to others; its error is small
#: against that of an observation.
MAX_TRUTH_GAP = NS // 4

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
    limit = _outlier_limit(dof)
    truncated_mean = dof * chdtr(dof + 2, limit) / chdtr(dof, limit)
    variance, kept = float(np.median(d2)) / chdtri(dof, 0.5), 0
    while (count := int((d2 <= limit * variance).sum())) > kept:
        variance, kept = float(d2[d2 <= limit * variance].mean()) / truncated_mean, count
    return NoiseScale(math.sqrt(variance), 1.0 / math.sqrt(2 * dof * len(d2)), len(d2))


def _outlier_limit(dof: int) -> float:
    """Return the normalised error squared of noise of scale 1 beyond which it is an outlier."""
    return float(chdtri(dof, OUTLIER_PROBABILITY))


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
    truth = RecordedTruth()
    odometry: dict[str, list[Odometry]] = defaultdict(list)
    scans: dict[tuple[str, str], list[Scan | RobotScan]] = defaultdict(list)
    for record in records:
        if isinstance(record, (TruePose, TrueLandmarks)):
            truth.add(record)
        elif isinstance(record, Odometry):
            odometry[record.robot].append(record)
        elif isinstance(record, (Scan, RobotScan)):
            kind = 'robot' if isinstance(record, RobotScan) else 'landmark'
            scans[kind, record.robot].append(record)
    if not settings.shared_landmark_ids:
        # Which robot's IDs the true landmarks have is unknown.
        truth.landmarks.clear()
    errors: dict[str, dict[str, list[float]]] = {
        kind: {robot.name: [] for robot in settings.robots} for kind in DOF}
    near = {}
    for robot in settings.robots:
        of_robot = sorted(odometry[robot.name], key=attrgetter('stamp'))
        errors['odometry'][robot.name] += _odometry_errors(of_robot, truth, robot)
        near[robot.name] = NearTruth(truth, robot.name, of_robot)
    for (kind, name), unordered in scans.items():
        if name in near:
            ordered = sorted(unordered, key=attrgetter('stamp'))
            single = [e for scan in ordered for e in _observation_errors(scan, truth, near)]
            errors[kind][name] += _in_windows(single)
    return {kind: by_robot for kind, by_robot in errors.items() if any(by_robot.values())}


def _odometry_errors(
    odometry: Sequence[Odometry], truth: RecordedTruth, settings: NoiseSettings
) -> Iterator[float]:
    """Yield the normalised error squared of each window between known true poses."""
    begin, x, P = None, np.zeros(3), np.zeros((3, 3))
    for earlier, later in pairwise(odometry):
        if later.stamp - earlier.stamp > MAX_ODOMETRY_WINDOW:
            begin = None
            continue
        if begin is None or later.stamp - begin.stamp > MAX_ODOMETRY_WINDOW:
            if not truth.covers(earlier.robot, earlier.stamp):
                continue
            begin, x, P = earlier, np.zeros(3), np.zeros((3, 3))
        x, P = models.composed_increment(x, P, *increment(earlier, later, settings))
        if later.stamp - begin.stamp >= ERROR_WINDOW and truth.covers(
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
        nearest = self._isolated[max(after - 1, 0):after + 1]
        near = [s for s in nearest if abs(s - stamp) <= MAX_TRUTH_GAP]
        if not near:
            return None
        known = min(near, key=lambda s: abs(s - stamp))
        begin, end = self._odometry_at(known), self._odometry_at(stamp)
        if begin is None or end is None:
            return None
        return compose(self._truth.pose(self._robot, known), between(begin, end))

    def _odometry_at(self, stamp: int) -> Array | None:
        after = bisect_left(self._odometry, stamp, key=attrgetter('stamp'))
        if after == len(self._odometry):
            return None
        if self._odometry[after].stamp == stamp:
            return self._odometry[after].pose
        if after == 0:
            return None
        earlier, later = self._odometry[after - 1], self._odometry[after]
        fraction = (stamp - earlier.stamp) / (later.stamp - earlier.stamp)
        return interpolated(earlier.pose, later.pose, fraction)


class ObservationError(NamedTuple):
    """Error of an observation of a landmark or robot, in the robot's frame."""

    observed: int | str  #: ID or name
    stamp: int  #: [ns]
    e: Array  #: (2,) [m]
    R: Array  #: stated covariance (2, 2) [m^2]


def _observation_errors(
    scan: Scan | RobotScan, truth: RecordedTruth, near: Mapping[str, NearTruth]
) -> Iterator[ObservationError]:
    """Yield the error of each observation whose true position is known."""
    pose = near[scan.robot].pose(scan.stamp)
    if pose is None:
        return
    for o in scan.observations:
        observed: int | str
        if isinstance(o, Observation):
            observed, point = o.id, truth.landmarks.get(o.id)
        else:
            observed = o.observed
            point = near[observed].pose(scan.stamp) if observed in near else None
        if point is not None:
            e = o.z - models.h(pose[None], point[None, :2])[0]
            yield ObservationError(observed, scan.stamp, e, o.R)


def _in_windows(errors: Sequence[ObservationError]) -> Iterator[float]:
    """Yield the sum of the errors of each window, normalised and squared, without outliers."""
    if not errors:
        return
    squared = [float(nees(error.e, error.R)) for error in errors]
    limit = _outlier_limit(2) * noise_scale(squared, 2).scale ** 2
    windows: dict[int | str, list[list[ObservationError]]] = defaultdict(list)
    for error, d2 in zip(errors, squared):
        if d2 > limit:
            continue
        of_observed = windows[error.observed]
        if not of_observed or error.stamp - of_observed[-1][0].stamp >= ERROR_WINDOW:
            of_observed.append([])
        of_observed[-1].append(error)
    for window in chain.from_iterable(windows.values()):
        e = np.sum([error.e for error in window], axis=0)
        R = np.sum([error.R for error in window], axis=0)
        yield float(nees(e, R))
