# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The errors of an MRCLAM set's commands and camera, measured against its motion capture.

Observations that are wrong by more than 0.75 m or 0.1 rad are gross and left out of what is said of
the others.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
import math

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from fej_slam_ros.core.geometry import Array, Flags, poses_at, wrap_all
from fej_slam_ros.core.models import h, h_pose
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam.conversion import LONGEST_HOLD, odometry, Reading, STANDING
from fej_slam_ros.datasets.mrclam.files import DataSet, RobotLog, ROBOTS, Series, Stamps

#: Truth is interpolated over gaps up to this [ns].
LONGEST_GAP = NS // 10

#: Fewer windows of `GROWTH_WINDOW`, or observations of a kind, tell nothing of the noise.
ENOUGH_WINDOWS, ENOUGH_OBSERVATIONS = 10, 200

GROSS_RANGE, GROSS_BEARING = 0.75, 0.1

#: Files tell ranges to a millimetre and bearings to a milliradian, so nothing is known better.
LEAST_SIGMA = 1e-3

#: Windows [s] over which increments are compared: for the delay, and for what errors add up to.
DELAY_WINDOW, GROWTH_WINDOW = 0.2, 5.0

#: A robot follows its commands within this [s].
MOST_DELAY = 0.5

#: Lags [s] between which errors of one robot and one subject are compared with each other.
LAGS = ((0.0, 0.3), (0.3, 1.0), (1.0, 2.0), (2.0, 4.0), (4.0, 8.0), (8.0, 15.0))

#: Weights of squared errors are from the fit before, and settle in so many rounds.
ROUNDS = 10


@dataclass(frozen=True, slots=True, eq=False)
class ObservationErrors:
    """
    Errors (n,) of observations, measured less true.

    Attributes
    ----------
    seers, subjects : who saw whom
    seconds : when
    true_ranges : how far away [m]
    ranges, bearings : errors [m, rad]

    """

    observers: Array
    subjects: Array
    seconds: Array
    true_ranges: Array
    ranges: Array
    bearings: Array

    def where(self, wanted: Flags) -> 'ObservationErrors':
        """Return some of them."""
        return ObservationErrors(*(getattr(self, part.name)[wanted] for part in fields(self)))

    def gross(self) -> Flags:
        """Return which are so wrong that they say nothing of the others."""
        return (np.abs(self.ranges) > GROSS_RANGE) | (np.abs(self.bearings) > GROSS_BEARING)


@dataclass(frozen=True, slots=True)
class ObservationNoise:
    """
    What the errors of some observations are like, the gross ones counted only.

    Attributes
    ----------
    count, gross : of all, and of the gross ones
    range_sd, range_mean, bearing_sd, bearing_mean : of errors [m, rad]
    range_growth : root mean square of range errors for each metre of the range
    bearing_rms : root mean square of bearing errors [rad]
    correlation : of range errors that lie between two lags [s] apart; nan where there are none

    """

    count: int
    gross: int
    range_sd: float
    range_mean: float
    bearing_sd: float
    bearing_mean: float
    range_growth: float
    bearing_rms: float
    correlation: Mapping[tuple[float, float], float]


@dataclass(frozen=True, slots=True, eq=False)
class OdometryErrors:
    """
    What robots did in windows of time.

    Attributes
    ----------
    true, measured : (n, 3) arrays, poses at the end in the frame of the beginning [m, m, rad]
    driven : (n, 2) array, metres and radians that were commanded, each without sign

    """

    true: Array
    measured: Array
    driven: Array

    def errors(self) -> Array:
        """Return what odometry lacks, (n, 3)."""
        errors = self.true - self.measured
        errors[:, 2] = wrap_all(errors[:, 2])
        return errors


def can_tell(data: DataSet) -> bool:
    """Return whether robots were watched while they drove, and where the landmarks are."""
    watched = increments(data, Reading(), GROWTH_WINDOW).true
    return bool(data.landmarks) and len(watched) >= ENOUGH_WINDOWS


def measured(
    data: DataSet, motion_delay: float | None = None,
    odometry_scale: tuple[float, float] | None = None,
) -> Reading:
    """Return delay and scale, unless they are given, and the noise that remains with them."""
    reading = Reading(odometry_scale=(1.0, 1.0))
    if motion_delay is None:
        motion_delay = _delay(data, reading)
    reading = replace(reading, motion_delay=motion_delay)
    reading = replace(reading, odometry_scale=odometry_scale or _scale(data, reading))
    made = increments(data, reading, GROWTH_WINDOW)
    squares = np.square(made.errors())
    way, heading = (
        _growth(squares[:, k], made.driven, GROWTH_WINDOW * STANDING[k]) for k in (0, 2))
    noise = replace(reading.noise, way=way, heading=heading)
    landmarks, robots = observation_errors(data)
    if (~landmarks.gross()).sum() >= ENOUGH_OBSERVATIONS:
        r, beta = _sigmas(landmarks)
        noise = replace(noise, range=r, bearing=beta)
    if (~robots.gross()).sum() >= ENOUGH_OBSERVATIONS:
        r, beta = _sigmas(robots)
        noise = replace(noise, robot_range=r, robot_bearing=beta)
    return replace(reading, noise=noise)


def observation_errors(data: DataSet) -> tuple[ObservationErrors, ObservationErrors]:
    """Return the errors of observations of landmarks and of robots, as far as truth reaches."""
    parts = [_errors_of(data, robot, log) for robot, log in data.logs.items()]
    errors = ObservationErrors(*(np.concatenate(column) for column in zip(*parts)))
    robots = np.isin(errors.subjects, ROBOTS)
    return errors.where(~robots), errors.where(robots)


def observation_noise(errors: ObservationErrors) -> ObservationNoise:
    """Return what errors are like, of which some are not gross."""
    gross = errors.gross()
    fine = errors.where(~gross)
    relative = fine.ranges / fine.true_ranges
    return ObservationNoise(
        len(gross), int(gross.sum()), float(fine.ranges.std()), float(fine.ranges.mean()),
        float(fine.bearings.std()), float(fine.bearings.mean()), _rms(relative),
        _rms(fine.bearings), _correlations(fine, relative - relative.mean()))


def increments(data: DataSet, reading: Reading, window: float) -> OdometryErrors:
    """Return what the robots of a set did in windows [s], as far as truth reaches."""
    parts = [_increments(log, reading, window) for log in data.logs.values()]
    return OdometryErrors(*(np.vstack(column) for column in zip(*parts)))


def true_poses(truth: Series, stamps: Stamps) -> tuple[Array, Flags]:
    """Return poses (n, 3) interpolated in time, and where truth tells them."""
    if len(truth) < 2:
        return np.zeros((len(stamps), 3)), np.zeros(len(stamps), dtype=bool)
    after = np.searchsorted(truth.stamps, stamps).clip(1, len(truth) - 1)
    t0, t1 = truth.stamps[after - 1], truth.stamps[after]
    steps = truth.rows[after] - truth.rows[after - 1]
    steps[:, 2] = wrap_all(steps[:, 2])
    poses = truth.rows[after - 1] + ((stamps - t0) / (t1 - t0))[:, None] * steps
    return poses, (t0 <= stamps) & (stamps <= t1) & (t1 - t0 <= LONGEST_GAP)


def _errors_of(data: DataSet, robot: int, log: RobotLog) -> tuple[Array, ...]:
    """Return the columns of one robot's errors."""
    stamps, (subjects, r, beta) = log.observations.stamps, log.observations.rows.T
    poses, known = true_poses(log.truth, stamps)
    places = np.full((len(stamps), 2), np.nan)
    for subject in np.unique(subjects).astype(int).tolist():
        of = subjects == subject
        if subject in data.logs:
            there, told = true_poses(data.logs[subject].truth, stamps[of])
            places[of] = np.where(told[:, None], there[:, :2], np.nan)
        else:
            places[of] = data.landmarks.get(subject, np.full(2, np.nan))
    x, y = h(poses, places).T
    known &= np.isfinite(x)
    columns = (
        np.full(len(stamps), float(robot)), subjects, stamps / NS, np.hypot(x, y),
        r - np.hypot(x, y), wrap_all(beta - np.arctan2(y, x)))
    return tuple(column[known] for column in columns)


def _increments(log: RobotLog, reading: Reading, window: float) -> tuple[Array, Array, Array]:
    stamps, poses = odometry(log, reading)
    edges = np.arange(stamps[0], stamps[-1], round(window * NS))
    dt = np.diff(stamps)[:, None]
    amounts = np.hstack([np.abs(log.commands.rows[:-1]) * dt / NS, dt > LONGEST_HOLD])
    sums = np.vstack([np.zeros(3), np.cumsum(amounts, axis=0)])
    driven = np.diff(
        np.column_stack([np.interp(edges, stamps, column) for column in sums.T]), axis=0)
    truth, known = true_poses(log.truth, edges)
    # What a robot did in a long gap of its commands is no error of them.
    told = known[:-1] & known[1:] & (driven[:, 2] == 0.0)
    measured_ = poses_at(edges, stamps, poses)
    return _differences(truth)[told], _differences(measured_)[told], driven[told, :2]


def _differences(poses: Array) -> Array:
    """Return each later pose in the frame of the one before, (n - 1, 3)."""
    return h_pose(poses[:-1], poses[1:])


def _delay(data: DataSet, reading: Reading) -> float:
    """Return the delay [s] with which the commands tell best how robots turn."""
    def error(delay: float) -> float:
        made = increments(data, replace(reading, motion_delay=delay), DELAY_WINDOW)
        return _rms(made.errors()[:, 2])

    return float(minimize_scalar(error, bounds=(0.0, MOST_DELAY), options={'xatol': 1e-3}).x)


def _scale(data: DataSet, reading: Reading) -> tuple[float, float]:
    """Return true over commanded speed, ahead and turning, by least squares."""
    turning = _ratio(increments(data, reading, GROWTH_WINDOW), 2)
    # The way goes where the robot faces, so that has to be right first.
    turned = replace(reading, odometry_scale=(1.0, turning))
    return _ratio(increments(data, turned, GROWTH_WINDOW), 0), turning


def _ratio(made: OdometryErrors, axis: int) -> float:
    """Return true over measured increments; robots that never move tell none other than 1."""
    true, measured_ = made.true[:, axis], made.measured[:, axis]
    moved = float(measured_ @ measured_)
    return float(true @ measured_) / moved if moved else 1.0


def _growth(squares: Array, driven: Array, least: float) -> tuple[float, float]:
    """Return c with which squares (n,) are driven (n, 2) @ c + least in the mean, c >= 0."""
    variances = np.full(len(squares), squares.mean() + least)
    for _ in range(ROUNDS):
        # The square of an error varies by its mean.
        c, _ = nnls(driven / variances[:, None], (squares - least) / variances)
        variances = driven @ c + least
    return float(c[0]), float(c[1])


def _sigmas(errors: ObservationErrors) -> tuple[float, float]:
    """Return standard deviations of ranges, for each metre, and of bearings."""
    found = observation_noise(errors)
    return max(found.range_growth, LEAST_SIGMA), max(found.bearing_rms, LEAST_SIGMA)


def _correlations(errors: ObservationErrors, values: Array) -> dict[tuple[float, float], float]:
    """Return how values of one robot and one subject are correlated, by lag."""
    products: dict[tuple[float, float], list[Array]] = {lags: [] for lags in LAGS}
    for pair in np.unique(np.column_stack([errors.observers, errors.subjects]), axis=0):
        of = (errors.observers == pair[0]) & (errors.subjects == pair[1])
        seconds, mine = errors.seconds[of], values[of]
        for (low, high), found in products.items():
            first, last = (np.searchsorted(seconds, seconds + lag, 'right') for lag in (low, high))
            found += [mine[k] * mine[a:b] for k, (a, b) in enumerate(zip(first, last))]
    variance = float(np.square(values).mean()) or math.nan
    return {lags: _mean(np.concatenate(found)) / variance for lags, found in products.items()}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.square(values).mean()))


def _mean(values: Array) -> float:
    return float(values.mean()) if len(values) else math.nan
