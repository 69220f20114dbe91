# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Noise of an MRCLAM set's commands and camera, measured against its motion capture.

Observations with errors above 0.75 m or 0.1 rad are outliers, which are excluded from the
statistics of noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
import math

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from fej_slam_ros.core.geometry import Array, Flags, poses_at, wrap_all
from fej_slam_ros.core.models import h, h_pose
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam.conversion import (
    ConversionOptions, increment_variances, MAX_COMMAND_HOLD, odometry, OFFSET_SIGMA,
    STANDSTILL_VARIANCE, sums_between, TRUTH_SIGMA)
from fej_slam_ros.datasets.mrclam.files import MrclamSet, ROBOT_SUBJECTS, RobotLog
from fej_slam_ros.datasets.mrclam.series import Series, Stamps

#: Ground truth is interpolated over gaps up to this [ns].
MAX_TRUTH_GAP = NS // 10
#: Minimum number of windows for the growth of errors, and of observations of a kind, for an
#: estimate; with fewer windows of `HEADING_WINDOW` those of `GROWTH_WINDOW` are used.
MIN_WINDOWS, MIN_OBSERVATIONS = 10, 200
#: Range [m] and bearing errors [rad] above which an observation is an outlier.
OUTLIER_RANGE, OUTLIER_BEARING = 0.75, 0.1
#: Lower bound of estimated sigmas, the resolution of the files: ranges in mm, bearings in mrad.
MIN_SIGMA = 1e-3
#: Windows [s] over which increments are compared: for the delay, and for the growth of errors of
#: positions and of headings, which persist for longer.
DELAY_WINDOW, GROWTH_WINDOW, HEADING_WINDOW = 0.2, 5.0, 20.0
#: Longest window [s] between true poses for the turns of a robot that were not commanded, in which
#: a heading error stays well below half a turn, and standard deviations of these turns among
#: robots [rad/m, rad/rad].
MAX_TURN_WINDOW = 60.0
OWN_TURN_SIGMA = np.array([0.1, 0.1])
#: Time [s] over which bearing errors of a robot stay about the same.
OFFSET_WINDOW = 60.0
#: Upper bound of the delay from a command to the motion [s].
MAX_DELAY = 0.5
#: Lags [s] between which errors of one robot and one subject are correlated.
LAGS = ((0.0, 0.3), (0.3, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 15.0))
#: Iterations of the reweighted least squares for the growth of errors, enough to converge.
REWEIGHTINGS = 10


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

    def outliers(self) -> Flags:
        """Return which observations are outliers."""
        return (np.abs(self.ranges) > OUTLIER_RANGE) | (np.abs(self.bearings) > OUTLIER_BEARING)


@dataclass(frozen=True, slots=True)
class ObservationNoise:
    """Statistics of observation errors without outliers."""

    #: Number of all observations, and of the outliers.
    count: int
    outliers: int
    #: Statistics of the errors [m, rad].
    range_sd: float
    range_mean: float
    bearing_sd: float
    bearing_mean: float
    range_growth: float  #: Root mean square of range errors per metre of range
    bearing_rms: float  #: Root mean square of bearing errors [rad]
    #: Correlation of range errors by interval of lags [s]; nan without pairs.
    correlation: Mapping[tuple[float, float], float]


@dataclass(frozen=True, slots=True, eq=False)
class WindowIncrements:
    """Motion of robots over windows of time."""

    #: (n, 3) arrays, poses at the end in the frame of the beginning [m, m, rad]; turns beyond half
    #: a turn are not wrapped.
    true: Array
    measured: Array
    commanded: Array  #: (n, 2) array, distance [m] and turn [rad] that were commanded, unsigned

    def errors(self) -> Array:
        """Return the errors of odometry, true - measured, (n, 3)."""
        return self.true - self.measured


def is_measurable(data: MrclamSet) -> bool:
    """Return whether the set has enough true poses of robots in motion."""
    return len(increments(data, ConversionOptions(), GROWTH_WINDOW).true) >= MIN_WINDOWS


def measured_options(
    data: MrclamSet, motion_delay: float | None = None,
    odometry_scale: tuple[float, float] | None = None,
) -> ConversionOptions:
    """Return the options with measured delay and scale, unless given, and the remaining noise."""
    options = ConversionOptions(odometry_scale=(1.0, 1.0))
    if motion_delay is None:
        motion_delay = _delay(data, options)
    options = replace(options, motion_delay=motion_delay)
    options = replace(options, odometry_scale=odometry_scale or _scale(data, options))
    options = replace(options, own_turns=own_turns(data, options))
    position = _growth(increments(data, options, GROWTH_WINDOW), 0, GROWTH_WINDOW)
    windows, seconds = increments(data, options, HEADING_WINDOW), HEADING_WINDOW
    if len(windows.true) < MIN_WINDOWS:
        windows, seconds = increments(data, options, GROWTH_WINDOW), GROWTH_WINDOW
    heading = _growth(windows, 2, seconds)
    noise = replace(options.noise, position=position, heading=heading)
    landmarks, robots = observation_errors(data)
    offsets = bearing_offsets(landmarks)
    landmarks, robots = without_offsets(landmarks, offsets), without_offsets(robots, offsets)
    if (~landmarks.outliers()).sum() >= MIN_OBSERVATIONS:
        r, beta = _sigmas(landmarks)
        noise = replace(noise, range=r, bearing=beta)
    if (~robots.outliers()).sum() >= MIN_OBSERVATIONS:
        r, beta = _sigmas(robots)
        noise = replace(noise, robot_range=r, robot_bearing=beta)
    return replace(options, noise=noise, bearing_offsets=offsets)


def best_options(
    data: MrclamSet, motion_delay: float | None = None,
    odometry_scale: tuple[float, float] | None = None,
) -> ConversionOptions:
    """
    Return the options as given, else as measured, else the defaults.

    Without the ground truth that `is_measurable` needs, only the turns of robots that were not
    commanded are measured.

    """
    if is_measurable(data):
        return measured_options(data, motion_delay, odometry_scale)
    options = ConversionOptions()
    if motion_delay is not None:
        options = replace(options, motion_delay=motion_delay)
    options = replace(options, odometry_scale=odometry_scale or options.odometry_scale)
    return replace(options, own_turns=own_turns(data, options))


def own_turns(data: MrclamSet, options: ConversionOptions) -> dict[int, tuple[float, float]]:
    """
    Return the turns of each robot that it was not commanded, per metre and per radian.

    Weighted least squares over windows between true poses, which may be sparse, with the prior
    `OWN_TURN_SIGMA`: without true poses they are zero.

    """
    return {robot: _own_turns(log, options) for robot, log in data.logs.items()}


def _own_turns(log: RobotLog, options: ConversionOptions) -> tuple[float, float]:
    stamps, poses = odometry(log, options)
    true = log.truth.between(stamps[0], stamps[-1])
    windows = (true.stamps - stamps[0]) // round(GROWTH_WINDOW * NS)
    true = true.where(np.diff(windows, prepend=-1) > 0)
    dt = np.diff(stamps)[:, None] / NS
    amounts = np.hstack([
        log.commands.rows[:-1] * options.odometry_scale * dt,
        increment_variances(log, options)[:, 2:]])
    driven, turned, variances = sums_between(true.stamps, stamps, amounts).T
    headings = poses_at(true.stamps, stamps, poses)[:, 2]
    errors = wrap_all(np.diff(true.rows[:, 2]) - np.diff(headings))
    used = np.diff(true.stamps) <= MAX_TURN_WINDOW * NS
    weights = used / (variances + 2.0 * TRUTH_SIGMA[2] ** 2)
    A = np.column_stack([driven, turned])
    N = (A.T * weights) @ A + np.diag(OWN_TURN_SIGMA ** -2)
    per_metre, per_radian = np.linalg.solve(N, A.T @ (weights * errors)).tolist()
    return per_metre, per_radian


def observation_errors(data: MrclamSet) -> tuple[ObservationErrors, ObservationErrors]:
    """Return the errors of the observations of landmarks and of robots with ground truth."""
    parts = [_errors_of(data, robot, log) for robot, log in data.logs.items()]
    errors = ObservationErrors(*(np.concatenate(column) for column in zip(*parts)))
    robots = np.isin(errors.subjects, ROBOT_SUBJECTS)
    return errors.where(~robots), errors.where(robots)


def bearing_offsets(errors: ObservationErrors) -> dict[int, tuple[float, float]]:
    """
    Return the mean bearing error of each robot, its camera's angle, with its sigma [rad].

    Errors within `OFFSET_WINDOW` count as one; the prior is `OFFSET_SIGMA`.

    """
    inliers = errors.where(~errors.outliers())
    offsets = {}
    for robot in np.unique(inliers.observers).astype(int).tolist():
        own = inliers.where(inliers.observers == robot)
        windows = (own.seconds // OFFSET_WINDOW).astype(int)
        means = np.array([own.bearings[windows == k].mean() for k in np.unique(windows)])
        if len(means) > 1:
            variance = means.var(ddof=1) / len(means)
            weight = OFFSET_SIGMA ** 2 / (OFFSET_SIGMA ** 2 + variance)
            offsets[robot] = float(weight * means.mean()), float(np.sqrt(weight * variance))
    return offsets


def without_offsets(
    errors: ObservationErrors, offsets: Mapping[int, tuple[float, float]]
) -> ObservationErrors:
    """Return the errors without the offsets of bearings by robot."""
    own = np.array([offsets.get(int(robot), (0.0, 0.0))[0] for robot in errors.observers])
    return replace(errors, bearings=errors.bearings - own)


def observation_noise(errors: ObservationErrors) -> ObservationNoise:
    """Return the statistics of errors; at least one must not be an outlier."""
    outliers = errors.outliers()
    inliers = errors.where(~outliers)
    relative = inliers.ranges / inliers.true_ranges
    return ObservationNoise(
        len(outliers), int(outliers.sum()), float(inliers.ranges.std()),
        float(inliers.ranges.mean()), float(inliers.bearings.std()),
        float(inliers.bearings.mean()), _rms(relative), _rms(inliers.bearings),
        _correlations(inliers, relative - relative.mean()))


def increments(data: MrclamSet, options: ConversionOptions, window: float) -> WindowIncrements:
    """Return the motion of the robots of a set over windows [s] with ground truth."""
    parts = [_increments(log, options, window) for log in data.logs.values()]
    return WindowIncrements(*(np.vstack(column) for column in zip(*parts)))


def true_poses(truth: Series, stamps: Stamps) -> tuple[Array, Flags]:
    """Return poses (n, 3) interpolated in time, and at which stamps ground truth is known."""
    if len(truth) < 2:
        return np.zeros((len(stamps), 3)), np.zeros(len(stamps), dtype=bool)
    after = np.searchsorted(truth.stamps, stamps).clip(1, len(truth) - 1)
    t0, t1 = truth.stamps[after - 1], truth.stamps[after]
    steps = truth.rows[after] - truth.rows[after - 1]
    steps[:, 2] = wrap_all(steps[:, 2])
    poses = truth.rows[after - 1] + ((stamps - t0) / (t1 - t0))[:, None] * steps
    return poses, (t0 <= stamps) & (stamps <= t1) & (t1 - t0 <= MAX_TRUTH_GAP)


def _errors_of(data: MrclamSet, robot: int, log: RobotLog) -> tuple[Array, ...]:
    stamps, (subjects, r, beta) = log.observations.stamps, log.observations.rows.T
    poses, known = true_poses(log.truth, stamps)
    points = np.full((len(stamps), 2), np.nan)
    for subject in np.unique(subjects).astype(int).tolist():
        rows = subjects == subject
        if subject in data.logs:
            observed_poses, is_known = true_poses(data.logs[subject].truth, stamps[rows])
            points[rows] = np.where(is_known[:, None], observed_poses[:, :2], np.nan)
        else:
            points[rows] = data.landmarks.get(subject, np.full(2, np.nan))
    x, y = h(poses, points).T
    known &= np.isfinite(x)
    columns = (
        np.full(len(stamps), float(robot)), subjects, stamps / NS, np.hypot(x, y),
        r - np.hypot(x, y), wrap_all(beta - np.arctan2(y, x)))
    return tuple(column[known] for column in columns)


def _increments(
    log: RobotLog, options: ConversionOptions, window: float
) -> tuple[Array, Array, Array]:
    stamps, poses = odometry(log, options)
    edges = np.arange(stamps[0], stamps[-1], round(window * NS))
    dt = np.diff(stamps)[:, None]
    amounts = np.hstack([np.abs(log.commands.rows[:-1]) * dt / NS, dt > MAX_COMMAND_HOLD])
    commanded = sums_between(edges, stamps, amounts)
    truth, known = true_poses(log.truth, edges)
    # Motion in a long gap between commands is not an odometry error.
    used = known[:-1] & known[1:] & (commanded[:, 2] == 0.0)
    true, measured = _differences(truth), _differences(poses_at(edges, stamps, poses))
    # A robot may turn by more than half a turn in a window.
    measured[:, 2] = np.diff(np.interp(edges, stamps, np.unwrap(poses[:, 2])))
    true[:, 2] = measured[:, 2] + wrap_all(true[:, 2] - measured[:, 2])
    return true[used], measured[used], commanded[used, :2]


def _differences(poses: Array) -> Array:
    """Return each later pose in the frame of the previous one, (n - 1, 3)."""
    return h_pose(poses[:-1], poses[1:])


def _delay(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the delay [s] with which the commands fit the turns of the robots best."""
    def error(delay: float) -> float:
        windows = increments(data, replace(options, motion_delay=delay), DELAY_WINDOW)
        return _rms(windows.errors()[:, 2])

    return float(minimize_scalar(error, bounds=(0.0, MAX_DELAY), options={'xatol': 1e-3}).x)


def _scale(data: MrclamSet, options: ConversionOptions) -> tuple[float, float]:
    """Return the ratios of true to commanded speed, forward and turning, by least squares."""
    turning = _ratio(increments(data, options, GROWTH_WINDOW), 2)
    # The forward increment depends on the heading, so the turns are scaled first.
    turned = replace(options, odometry_scale=(1.0, turning))
    return _ratio(increments(data, turned, GROWTH_WINDOW), 0), turning


def _ratio(windows: WindowIncrements, axis: int) -> float:
    """Return the ratio of true to measured increments; 1 for robots that never move."""
    true, measured = windows.true[:, axis], windows.measured[:, axis]
    moved = float(measured @ measured)
    return float(true @ measured) / moved if moved else 1.0


def _growth(windows: WindowIncrements, axis: int, seconds: float) -> tuple[float, float]:
    """Return c >= 0 so that squared errors are commanded @ c + standstill noise in the mean."""
    squares, constant = np.square(windows.errors()[:, axis]), seconds * STANDSTILL_VARIANCE[axis]
    variances = np.full(len(squares), squares.mean() + constant)
    for _ in range(REWEIGHTINGS):
        # The standard deviation of a squared error is proportional to its mean.
        c, _ = nnls(windows.commanded / variances[:, None], (squares - constant) / variances)
        variances = windows.commanded @ c + constant
    return float(c[0]), float(c[1])


def _sigmas(errors: ObservationErrors) -> tuple[float, float]:
    """Return standard deviations of ranges, per metre, and of bearings."""
    noise = observation_noise(errors)
    return max(noise.range_growth, MIN_SIGMA), max(noise.bearing_rms, MIN_SIGMA)


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
        lags: float(of.mean()) / variance if len(of) else math.nan for lags, of in pairs.items()}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.square(values).mean()))
