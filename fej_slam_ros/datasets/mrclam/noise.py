# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of an MRCLAM set's commands and camera, measured against its motion capture."""

from collections import Counter, defaultdict
from dataclasses import replace
from itertools import chain

import numpy as np
from scipy.optimize import nnls

from fej_slam_ros.core.calibration.from_truth import DOF, normalized_errors
from fej_slam_ros.core.calibration.scales_of_errors import noise_scale
from fej_slam_ros.core.calibration.team_records import TeamRecords
from fej_slam_ros.core.records import Odometry, TruePose
from fej_slam_ros.datasets.mrclam import camera_errors, command_errors, observation_errors
from fej_slam_ros.datasets.mrclam.camera_errors import (
    bearing_offsets, camera_noise, range_errors, remaining_errors)
from fej_slam_ros.datasets.mrclam.command_errors import increments, own_turns, WindowIncrements
from fej_slam_ros.datasets.mrclam.conversion import records, robot_name, STANDSTILL_VARIANCE
from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions, range_increase
from fej_slam_ros.datasets.mrclam.files import MrclamSet
from fej_slam_ros.datasets.mrclam.observation_errors import errors_near_truth, ObservationErrors
from fej_slam_ros.datasets.mrclam.run_settings import settings
from fej_slam_ros.datasets.mrclam.variances import variance_coefficients

#: Minimum number of windows for the growth of errors, and of observations of a kind, for an
#: estimate.
MIN_WINDOWS, MIN_OBSERVATIONS = 10, 200
#: Window [s] over which errors of odometry grow: they persist for seconds.
GROWTH_WINDOW = 5.0
#: Standard deviation of the growth of errors per metre and per radian, relative to that of set 6
#: times a common factor.
RATIO_SIGMA = 0.3
#: Correlation of true turns with those of odometry below which ground truth is that of another
#: robot or clock: it is 0.9 and more in real and simulated sets.
MIN_TURN_CORRELATION = 0.5
#: Smallest standard deviation [rad] of true turns within a window that determines it.
MIN_TURN_SPREAD = 0.2
#: Odometry as the commands state.
AS_COMMANDED = ConversionOptions(odometry_scale=(1.0, 1.0), slowdown=0.0)


def is_measurable(data: MrclamSet) -> bool:
    """Return whether the set has enough true poses of robots in motion."""
    return len(increments(data, ConversionOptions(), GROWTH_WINDOW).true) >= MIN_WINDOWS


def turn_correlation(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the correlation of all true turns with those of odometry; 1 if robots hardly turn."""
    windows = increments(data, options, GROWTH_WINDOW)
    true, measured = windows.true[:, 2], windows.measured[:, 2]
    if true.std() < MIN_TURN_SPREAD:
        return 1.0
    return float(np.corrcoef(true, measured)[0, 1]) if measured.std() else 0.0


def best_options(
    data: MrclamSet, motion_delay: float | None = None,
    odometry_scale: tuple[float, float] | None = None, camera_delay: float | None = None,
    thin: float = ConversionOptions.thin,
) -> ConversionOptions:
    """
    Return the options as given, else as measured, else the defaults.

    Without the ground truth that `is_measurable` needs, delays and scale are the defaults; the
    rest is measured between sparse true poses, and by observations near them.

    """
    if is_measurable(data):
        return _measured_options(data, motion_delay, odometry_scale, camera_delay, thin)
    options = ConversionOptions(thin=thin)
    if motion_delay is not None:
        options = replace(options, motion_delay=motion_delay)
    if camera_delay is not None:
        options = replace(options, camera_delay=camera_delay)
    options = _with_speeds(data, options, options.odometry_scale[1], odometry_scale)
    factor = _odometry_variance_factor(data, options)
    noise = replace(
        options.noise, position=_scaled(options.noise.position, factor),
        heading=_scaled(options.noise.heading, factor))
    return _with_observation_noise(
        replace(options, noise=noise), *errors_near_truth(data, options), noise.landmarks.range,
        noise.landmarks.bearing)


def _measured_options(
    data: MrclamSet, motion_delay: float | None, odometry_scale: tuple[float, float] | None,
    camera_delay: float | None, thin: float,
) -> ConversionOptions:
    """Return the options with measured delays and scale, unless given, and the remaining noise."""
    if motion_delay is None:
        motion_delay = command_errors.motion_delay(data, AS_COMMANDED)
    options = ConversionOptions(motion_delay=motion_delay, thin=thin)
    as_commanded = replace(AS_COMMANDED, motion_delay=motion_delay)
    turn_ratio = command_errors.turn_ratio(data, as_commanded)
    options = _with_speeds(data, options, turn_ratio, odometry_scale)
    windows, usual = increments(data, options, GROWTH_WINDOW), options.noise
    noise = replace(
        usual, position=_growth(windows, 0, usual.position),
        heading=_growth(windows, 2, usual.heading))
    if camera_delay is None:
        camera_delay = camera_errors.camera_delay(data, options)
    options = replace(options, noise=noise, camera_delay=camera_delay)
    options = _with_observation_noise(
        options, *observation_errors.observation_errors(data, camera_delay))
    return replace(options, correlation_factor=_correlation_factor(data, options))


def _with_speeds(
    data: MrclamSet, options: ConversionOptions, turn_ratio: float,
    given: tuple[float, float] | None,
) -> ConversionOptions:
    """Return options with the speeds to which commands lead, measured unless given."""
    if given is None:
        ahead, _ = options.odometry_scale
        options = replace(options, odometry_scale=(ahead, turn_ratio))
        ahead, slowdown = command_errors.forward_speed(data, options)
        options = replace(options, odometry_scale=(ahead, turn_ratio), slowdown=slowdown)
    else:
        options = replace(options, odometry_scale=given, slowdown=0.0)
    return replace(options, own_turns=own_turns(data, options))


def _with_observation_noise(
    options: ConversionOptions, landmarks: ObservationErrors, robots: ObservationErrors,
    least_range_sigma: float = 0.0, least_bearing_sigma: float = 0.0,
) -> ConversionOptions:
    """Return options with the errors of cameras, and the noise of observations if it is known."""
    of_bearings = bearing_offsets(landmarks, least_bearing_sigma)
    of_ranges = range_errors(landmarks, least_range_sigma)
    usual = options.noise
    found, increases = [usual.landmarks, usual.robots], [*options.range_increases]
    for k, errors in enumerate((landmarks, robots)):
        remaining = remaining_errors(errors, of_bearings, of_ranges)
        if len(remaining.inliers().ranges) >= MIN_OBSERVATIONS:
            found[k] = camera_noise(remaining)
            increases[k] = range_increase(found[k].range)
    return replace(
        options, noise=replace(usual, landmarks=found[0], robots=found[1]),
        bearing_offsets=of_bearings, range_errors=of_ranges,
        range_increases=(increases[0], increases[1]))


def _correlation_factor(data: MrclamSet, options: ConversionOptions) -> float:
    """
    Return the factor of the observations' noise over windows in which errors persist.

    It is the median of the robots: the motion capture of one may be wrong.

    """
    single = replace(options, correlation_factor=1.0, range_increases=(0.0, 0.0))
    observed = [
        (record, None) for record in records(data, single, defaultdict(Counter))
        if not isinstance(record, Odometry)]
    of_run = settings(data, single)
    errors = normalized_errors(TeamRecords(observed, of_run), of_run)
    of_robots = [
        noise_scale(squared, DOF['landmark']) for robot in data.logs
        if (squared := [d2 for kind in errors.values() for d2 in kind[robot_name(robot)]])]
    known = [found.scale for found in of_robots if found.is_known()]
    return max(float(np.median(known)), 1.0) if known else options.correlation_factor


def _odometry_variance_factor(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the ratio of variances of odometry to the stated ones; 1 if it is not known."""
    motions = [
        (record, None) for record in records(data, options, defaultdict(Counter))
        if isinstance(record, (Odometry, TruePose))]
    of_run = settings(data, options)
    errors = normalized_errors(TeamRecords(motions, of_run), of_run)
    if 'odometry' not in errors:
        return 1.0
    found = noise_scale([*chain.from_iterable(errors['odometry'].values())], DOF['odometry'])
    return found.scale ** 2 if found.is_known() else 1.0


def _scaled(variances: tuple[float, float], factor: float) -> tuple[float, float]:
    driving, turning = variances
    return factor * driving, factor * turning


def _growth(
    windows: WindowIncrements, axis: int, usual: tuple[float, float]
) -> tuple[float, float]:
    """
    Return c >= 0 so that squared errors are commanded @ c + standstill noise in the mean.

    Few windows do not separate driving from turning, so the ratio is drawn to that of `usual`.

    """
    errors, constant = windows.errors()[:, axis], GROWTH_WINDOW * STANDSTILL_VARIANCE[axis]
    (factor,), _ = nnls((windows.commanded @ usual)[:, None], np.square(errors) - constant)
    driving, turning = variance_coefficients(
        errors, windows.commanded, constant, factor * np.array(usual), RATIO_SIGMA)
    return float(driving), float(turning)
