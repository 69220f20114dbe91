# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors of an MRCLAM set's observations against its motion capture, and their statistics.

Observations with errors above 0.75 m or 0.1 rad, or five standard deviations if that is more, are
outliers, which are excluded from the statistics.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
import math

import numpy as np

from fej_slam_ros.core.calibration.odometry_errors import SIGMA_PER_MEDIAN
from fej_slam_ros.core.geometry import (
    Array, between, compose, Flags, interpolated_all, poses_at, Stamps, wrap_all)
from fej_slam_ros.core.models import h
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam.conversion import odometry
from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions
from fej_slam_ros.datasets.mrclam.files import MrclamSet, ROBOT_SUBJECTS, RobotLog
from fej_slam_ros.datasets.series import Series

#: Ground truth is interpolated over gaps up to this [ns].
MAX_TRUTH_GAP = NS // 10
#: Time [ns] from a sparse true pose within which odometry leads to observations: its error is
#: small against that of a bearing.
NEAR_TRUTH = NS // 4
#: Range [m] and bearing errors [rad], and standard deviations, above all of which an observation
#: is an outlier.
OUTLIER_RANGE, OUTLIER_BEARING, OUTLIER_SIGMAS = 0.75, 0.1, 5.0
#: Standard deviations of ranges, over their median, and of bearings [rad] from which on the ground
#: truth is wrong, and not the observations noisy.
MAX_RELATIVE_SIGMA, MAX_BEARING_SIGMA = 0.5, 1.0
#: Lags [s] between which errors of one robot and one subject are correlated.
LAGS = ((0.0, 0.3), (0.3, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 15.0))


@dataclass(frozen=True, slots=True, eq=False)
class ObservationErrors:
    """Errors (n,) of observations, measured - true."""

    #: Observer and subject of each observation.
    observers: Array
    subjects: Array
    seconds: Array  #: Time of each observation [s]
    true_ranges: Array  #: True distance [m]
    #: Errors [m, rad].
    ranges: Array
    bearings: Array

    def where(self, wanted: Flags) -> 'ObservationErrors':
        """Return the selected errors."""
        return ObservationErrors(*(getattr(self, part.name)[wanted] for part in fields(self)))

    def inliers(self) -> 'ObservationErrors':
        """Return the errors of the observations that are no outliers."""
        return self.where(~self.outliers())

    def outliers(self) -> Flags:
        """Return which observations are outliers."""
        if not len(self.ranges):
            return np.zeros(0, dtype=bool)
        max_range_sigma = MAX_RELATIVE_SIGMA * float(np.median(self.true_ranges))
        return (
            _exceeds(self.ranges, OUTLIER_RANGE, max_range_sigma)
            | _exceeds(self.bearings, OUTLIER_BEARING, MAX_BEARING_SIGMA))


@dataclass(frozen=True, slots=True)
class ErrorStatistics:
    """Statistics of observation errors without outliers."""

    #: Number of all observations, and of the outliers.
    count: int
    outliers: int
    #: Statistics of the errors [m, rad].
    range_sd: float
    range_mean: float
    bearing_sd: float
    bearing_mean: float
    relative_range_rms: float  #: Root mean square of range errors per metre of range
    bearing_rms: float  #: Root mean square of bearing errors [rad]
    #: Correlation of range errors by interval of lags [s]; nan without pairs.
    correlation: Mapping[tuple[float, float], float]


#: Poses (n, 3) of a robot at stamps (n,), and which are known.
PosesOf = Callable[[RobotLog, Stamps], tuple[Array, Flags]]


def observation_errors(
    data: MrclamSet, camera_delay: float = 0.0
) -> tuple[ObservationErrors, ObservationErrors]:
    """Return the errors of the observations of landmarks and of robots with ground truth."""
    return _errors(data, camera_delay, lambda log, stamps: true_poses(log.truth, stamps))


def errors_near_truth(
    data: MrclamSet, options: ConversionOptions
) -> tuple[ObservationErrors, ObservationErrors]:
    """Return the errors within `NEAR_TRUTH` of true poses, from which odometry leads to them."""
    return _errors(
        data, options.camera_delay, lambda log, stamps: _near_true_poses(log, options, stamps))


def _errors(
    data: MrclamSet, camera_delay: float, poses_of: PosesOf
) -> tuple[ObservationErrors, ObservationErrors]:
    delay = round(camera_delay * NS)
    parts = [_errors_of(data, robot, delay, poses_of) for robot in data.logs]
    errors = ObservationErrors(*(np.concatenate(column) for column in zip(*parts)))
    robots = np.isin(errors.subjects, ROBOT_SUBJECTS)
    return errors.where(~robots), errors.where(robots)


def error_statistics(errors: ObservationErrors) -> ErrorStatistics:
    """Return the statistics of errors; at least one must not be an outlier."""
    outliers, inliers = errors.outliers(), errors.inliers()
    relative = inliers.ranges / inliers.true_ranges
    return ErrorStatistics(
        len(outliers), int(outliers.sum()), float(inliers.ranges.std()),
        float(inliers.ranges.mean()), float(inliers.bearings.std()),
        float(inliers.bearings.mean()), rms(relative), rms(inliers.bearings),
        _correlations(inliers, relative - relative.mean()))


def true_poses(truth: Series, stamps: Stamps) -> tuple[Array, Flags]:
    """Return poses (n, 3) interpolated in time, and at which stamps ground truth is known."""
    if len(truth) < 2:
        return np.zeros((len(stamps), 3)), np.zeros(len(stamps), dtype=bool)
    after = np.searchsorted(truth.stamps, stamps).clip(1, len(truth) - 1)
    t0, t1 = truth.stamps[after - 1], truth.stamps[after]
    poses = interpolated_all(
        truth.rows[after - 1], truth.rows[after], (stamps - t0) / (t1 - t0))
    return poses, (t0 <= stamps) & (stamps <= t1) & (t1 - t0 <= MAX_TRUTH_GAP)


def _near_true_poses(
    log: RobotLog, options: ConversionOptions, stamps: Stamps
) -> tuple[Array, Flags]:
    """Return poses (n, 3) to which odometry leads from true poses, and where these are near."""
    poses, known = np.zeros((len(stamps), 3)), np.zeros(len(stamps), dtype=bool)
    if not len(log.truth):
        return poses, known
    odometry_stamps, driven = odometry(log, options)
    after = np.searchsorted(log.truth.stamps, stamps)
    either = np.column_stack([after - 1, after]).clip(0, len(log.truth) - 1)
    gaps = np.abs(log.truth.stamps[either] - stamps[:, None])
    nearest = either[np.arange(len(stamps)), gaps.argmin(axis=1)]
    begins = log.truth.stamps[nearest]
    known = (gaps.min(axis=1) <= NEAR_TRUTH) & (
        np.minimum(begins, stamps) >= odometry_stamps[0]) & (
        np.maximum(begins, stamps) <= odometry_stamps[-1])
    starts, ends = (poses_at(times, odometry_stamps, driven) for times in (begins, stamps))
    for k in np.flatnonzero(known):
        poses[k] = compose(log.truth.rows[nearest[k]], between(starts[k], ends[k]))
    return poses, known


def _errors_of(
    data: MrclamSet, robot: int, delay: int, poses_of: PosesOf
) -> tuple[Array, ...]:
    log = data.logs[robot]
    stamps, (subjects, r, beta) = log.observations.stamps - delay, log.observations.rows.T
    poses, known = poses_of(log, stamps)
    points = np.full((len(stamps), 2), np.nan)
    for subject in np.unique(subjects).astype(int).tolist():
        rows = subjects == subject
        if subject in data.logs:
            observed_poses, is_known = poses_of(data.logs[subject], stamps[rows])
            points[rows] = np.where(is_known[:, None], observed_poses[:, :2], np.nan)
        else:
            points[rows] = data.landmarks.get(subject, np.full(2, np.nan))
    x, y = h(poses, points).T
    known &= np.isfinite(x)
    columns = (
        np.full(len(stamps), float(robot)), subjects, stamps / NS, np.hypot(x, y),
        r - np.hypot(x, y), wrap_all(beta - np.arctan2(y, x)))
    return tuple(column[known] for column in columns)


def _correlations(errors: ObservationErrors, values: Array) -> dict[tuple[float, float], float]:
    """Return the correlation of values of one robot and one subject, by lag."""
    products: dict[tuple[float, float], list[Array]] = {lags: [] for lags in LAGS}
    for observer, subject in np.unique(
            np.column_stack([errors.observers, errors.subjects]), axis=0):
        of_pair = (errors.observers == observer) & (errors.subjects == subject)
        seconds, own = errors.seconds[of_pair], values[of_pair]
        for (low, high), at_lag in products.items():
            first, last = (np.searchsorted(seconds, seconds + lag, 'right') for lag in (low, high))
            at_lag += [own[k] * own[a:b] for k, (a, b) in enumerate(zip(first, last))]
    variance = float(np.square(values).mean()) or math.nan
    pairs = {lags: np.concatenate(at_lag) for lags, at_lag in products.items()}
    return {
        lags: float(samples.mean()) / variance if len(samples) else math.nan
        for lags, samples in pairs.items()}


def _exceeds(errors: Array, limit: float, max_sigma: float) -> Flags:
    """Return which errors are outliers; with a larger sigma, errors are wrong and no noise."""
    sizes = np.abs(errors)
    sigma = SIGMA_PER_MEDIAN * float(np.median(sizes))
    return sizes > (max(limit, OUTLIER_SIGMAS * sigma) if sigma < max_sigma else limit)


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
