# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Systematic errors and noise of an MRCLAM set's cameras, from errors of their observations."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
import math

import numpy as np
from scipy.optimize import minimize_scalar

from fej_slam_ros.core.calibration.shown_errors import MIN_GAIN
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.datasets.mrclam.conversion_options import (
    CameraNoise, ConversionOptions, OFFSET_SIGMA)
from fej_slam_ros.datasets.mrclam.files import MrclamSet
from fej_slam_ros.datasets.mrclam.observation_errors import (
    observation_errors, ObservationErrors, rms)
from fej_slam_ros.datasets.mrclam.variances import variance_coefficients

#: Lower bound of estimated sigmas, the resolution of the files: ranges in mm, bearings in mrad.
MIN_SIGMA = 1e-3
#: Time [s] over which errors of a robot's camera stay about the same.
OFFSET_WINDOW = 60.0
#: Standard deviations of the systematic errors of a camera's ranges: offset [m], and per metre.
RANGE_ERROR_SIGMA = np.array([0.05, 0.02])
#: Longest delay of cameras, length of the intervals in each of which it is sought, as the fit has
#: several minima, and the standard deviation of the delay where no robot turns [s]. Against
#: ground truth that is stamped late, delays are negative.
MAX_CAMERA_DELAY, DELAY_INTERVAL, CAMERA_DELAY_SIGMA = 0.6, 0.2, 0.05
DELAY_BEGINS = -0.6, -0.4, -0.2, 0.0, 0.2, 0.4
#: Offsets [s] among which that of a robot's clock is sought, the least that is another clock, the
#: ratio of spreads of bearings below which it is shown, and the least number of bearings for that.
#: In set 6 the ratio is 0.34 to 0.71 for a clock that is 0.5 s late, else 1.
CLOCK_OFFSETS, MIN_CLOCK_OFFSET = [k / 10.0 for k in range(-30, 31)], 0.25
SHOWN_SPREAD, MIN_BEARINGS = 0.8, 50


def bearing_offsets(
    errors: ObservationErrors, least_sigma: float = 0.0
) -> dict[int, tuple[float, float]]:
    """
    Return the mean bearing error of each robot, its camera's angle, and a sigma [rad].

    Errors within `OFFSET_WINDOW` count as one, of at least a sigma where their spread is not well
    known; the prior is `OFFSET_SIGMA`. The sigma is that of the error in one window: it contains
    the spread among windows, as of motion capture that is wrong for a minute.

    """
    inliers = errors.inliers()
    offsets = {}
    for robot in np.unique(inliers.observers).astype(int).tolist():
        own = inliers.where(inliers.observers == robot)
        windows = (own.seconds // OFFSET_WINDOW).astype(int)
        means = np.array([own.bearings[windows == k].mean() for k in np.unique(windows)])
        if len(means) > 1:
            spread = float(means.var(ddof=1))
            variance = max(spread, least_sigma ** 2) / len(means)
            weight = OFFSET_SIGMA ** 2 / (OFFSET_SIGMA ** 2 + variance)
            offsets[robot] = weight * float(means.mean()), math.sqrt(weight * variance + spread)
    return offsets


def range_errors(
    errors: ObservationErrors, least_sigma: float
) -> dict[int, tuple[float, float]]:
    """
    Return the systematic errors of each robot's ranges: offset [m], and error per metre.

    Least squares over errors per metre of range, with the prior `RANGE_ERROR_SIGMA`. Their
    variance is that of sums over `OFFSET_WINDOW`, in which they are correlated, and at least a
    sigma where their spread is not well known.

    """
    inliers, found = errors.inliers(), {}
    for robot in np.unique(inliers.observers).astype(int).tolist():
        own = inliers.where(inliers.observers == robot)
        A = np.column_stack([1.0 / own.true_ranges, np.ones(len(own.ranges))])
        b = own.ranges / own.true_ranges
        residuals = b - A @ np.linalg.lstsq(A, b)[0]
        _, windows = np.unique(own.seconds // OFFSET_WINDOW, return_inverse=True)
        sums = np.bincount(windows, residuals)
        if len(sums) > 2:
            # Two unknowns are fitted.
            variance = float(np.square(sums).sum()) / len(b) * len(sums) / (len(sums) - 2)
            variance = max(variance, least_sigma ** 2, MIN_SIGMA ** 2)
            N = A.T @ A / variance + np.diag(RANGE_ERROR_SIGMA ** -2)
            offset, per_metre = np.linalg.solve(N, A.T @ b / variance).tolist()
            found[robot] = offset, per_metre
    return found


def camera_delay(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the delay [s] with which bearings fit the true poses best, drawn to the usual one."""
    usual, sigma = options.camera_delay, options.noise.landmarks.bearing
    count = sum(len(log.observations) for log in data.logs.values())

    def cost(delay: float) -> float:
        landmarks, _ = observation_errors(data, delay)
        errors = remaining_errors(landmarks, bearing_offsets(landmarks), {})
        inliers = errors.inliers()
        fit = count * np.square(inliers.bearings / sigma).mean() if len(inliers.bearings) else 0.0
        return float(fit + ((delay - usual) / CAMERA_DELAY_SIGMA) ** 2)

    found = [
        minimize_scalar(cost, bounds=(begin, begin + DELAY_INTERVAL), options={'xatol': 1e-3})
        for begin in DELAY_BEGINS]
    return float(min(found, key=lambda minimum: minimum.fun).x)


def clock_offsets(data: MrclamSet, camera_delay: float) -> dict[int, float]:
    """
    Return by how much [s] observations of robots are late for their ground truth, if by much.

    That is where their bearings fit the true poses better than at the delay of the team.

    """
    spreads = {
        offset: _spreads(observation_errors(data, camera_delay + offset)[0], data.logs)
        for offset in CLOCK_OFFSETS}
    found = {}
    for robot in data.logs:
        of_robot = {offset: spread[robot] for offset, spread in spreads.items()}
        best = min(of_robot, key=lambda offset: of_robot[offset])
        if of_robot[best] < SHOWN_SPREAD * of_robot[0.0] < math.inf and (
                abs(best) > MIN_CLOCK_OFFSET):
            found[robot] = best
    return found


def _spreads(errors: ObservationErrors, robots: Iterable[int]) -> dict[int, float]:
    """Return the median deviation of each robot's bearings [rad], inf of too few."""
    own = {robot: errors.bearings[errors.observers == robot] for robot in robots}
    return {
        robot: float(np.median(np.abs(bearings - np.median(bearings))))
        if len(bearings) >= MIN_BEARINGS else math.inf for robot, bearings in own.items()}


def remaining_errors(
    errors: ObservationErrors, of_bearings: Mapping[int, tuple[float, float]],
    of_ranges: Mapping[int, tuple[float, float]],
) -> ObservationErrors:
    """Return the errors that remain without the `bearing_offsets` and `range_errors` by robot."""
    bearings, ranges = errors.bearings.copy(), errors.ranges.copy()
    for robot, (offset, _) in of_bearings.items():
        bearings[errors.observers == robot] -= offset
    for robot, (offset, per_metre) in of_ranges.items():
        own = errors.observers == robot
        ranges[own] -= offset + per_metre * errors.true_ranges[own]
    return replace(errors, bearings=bearings, ranges=ranges)


def camera_noise(errors: ObservationErrors) -> CameraNoise:
    """Return the standard deviations of errors without outliers."""
    inliers = errors.inliers()
    constant, per_metre = _range_sigmas(inliers.ranges, inliers.true_ranges)
    return CameraNoise(
        max(per_metre, MIN_SIGMA), max(rms(inliers.bearings), MIN_SIGMA), constant)


def _range_sigmas(errors: Array, r: Array) -> tuple[float, float]:
    """Return c [m] and p of the variance c^2 + p^2 r^2 of the errors (n,) of ranges r (n,) [m]."""
    A, least = np.column_stack([np.ones(len(r)), np.square(r)]), MIN_SIGMA ** 2
    c2, p2 = variance_coefficients(errors, A, least, np.ones(2))
    relative = rms(errors / r)
    proportional, variances = relative ** 2 * A[:, 1] + least, A @ [c2, p2] + least
    gain = 0.5 * float(np.sum(np.log(proportional / variances) + np.square(errors) * (
        1.0 / proportional - 1.0 / variances)))
    return (math.sqrt(c2), math.sqrt(p2)) if gain > MIN_GAIN else (0.0, relative)
