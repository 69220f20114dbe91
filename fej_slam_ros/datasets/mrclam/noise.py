# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of an MRCLAM set's commands and camera, measured against its motion capture."""

from collections import Counter, defaultdict
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from fej_slam_ros.core.calibration.from_truth import (
    DOF, noise_scale, noise_scales, normalized_errors)
from fej_slam_ros.core.geometry import Array, poses_at, wrap_all
from fej_slam_ros.core.models import h_pose
from fej_slam_ros.core.records import NS, Odometry, TruePose
from fej_slam_ros.datasets.mrclam.conversion import (
    ConversionOptions, increment_variances, MAX_COMMAND_HOLD, odometry, records,
    STANDSTILL_VARIANCE, sums_between)
from fej_slam_ros.datasets.mrclam.files import MrclamSet, RobotLog
from fej_slam_ros.datasets.mrclam.observation_errors import (
    bearing_offsets, errors_near_truth, observation_errors, ObservationErrors, range_errors, rms,
    sigmas, true_poses, without_systematic_errors)
from fej_slam_ros.datasets.mrclam.run_settings import settings, TRUTH_SIGMA

#: Minimum number of windows for the growth of errors, and of observations of a kind, for an
#: estimate; with fewer windows of `HEADING_WINDOW` those of `GROWTH_WINDOW` are used.
MIN_WINDOWS, MIN_OBSERVATIONS = 10, 200
#: Windows [s] over which increments are compared: for the delay, and for the growth of errors of
#: positions and of headings, which persist for longer.
DELAY_WINDOW, GROWTH_WINDOW, HEADING_WINDOW = 0.2, 5.0, 20.0
#: Longest window [s] between true poses for the turns of a robot that were not commanded, in which
#: a heading error stays well below half a turn, and standard deviations of these turns among
#: robots [rad/m, rad/rad].
MAX_TURN_WINDOW = 60.0
OWN_TURN_SIGMA = np.array([0.1, 0.1])
#: Standard deviation of the growth of errors per metre and per radian, relative to that of set 6
#: times a common factor.
RATIO_SIGMA = 0.3
#: Upper bounds of the delay from a command to the motion, and of that of a camera [s].
MAX_MOTION_DELAY, MAX_CAMERA_DELAY = 0.5, 0.2
#: Standard deviation of the delay of a camera, where no robot turns [s].
CAMERA_DELAY_SIGMA = 0.05
#: Iterations of the reweighted least squares for the growth of errors, enough to converge.
REWEIGHTINGS = 10


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
    odometry_scale: tuple[float, float] | None = None, camera_delay: float | None = None,
    thin: float = ConversionOptions.thin,
) -> ConversionOptions:
    """Return the options with measured delays and scale, unless given, and the remaining noise."""
    options = ConversionOptions(odometry_scale=(1.0, 1.0), thin=thin)
    if motion_delay is None:
        motion_delay = _delay(data, options)
    options = replace(options, motion_delay=motion_delay)
    options = replace(options, odometry_scale=odometry_scale or _scale(data, options))
    options = replace(options, own_turns=own_turns(data, options))
    usual = options.noise
    position = _growth(
        increments(data, options, GROWTH_WINDOW), 0, GROWTH_WINDOW, usual.position)
    windows, seconds = increments(data, options, HEADING_WINDOW), HEADING_WINDOW
    if len(windows.true) < MIN_WINDOWS:
        windows, seconds = increments(data, options, GROWTH_WINDOW), GROWTH_WINDOW
    heading = _growth(windows, 2, seconds, usual.heading)
    noise = replace(options.noise, position=position, heading=heading)
    if camera_delay is None:
        camera_delay = _camera_delay(data, options)
    options = replace(options, noise=noise, camera_delay=camera_delay)
    options = _with_observation_noise(options, *observation_errors(data, options.camera_delay))
    return replace(options, correlation_factor=_correlation_factor(data, options))


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
        return measured_options(data, motion_delay, odometry_scale, camera_delay, thin)
    options = ConversionOptions(thin=thin)
    if motion_delay is not None:
        options = replace(options, motion_delay=motion_delay)
    if camera_delay is not None:
        options = replace(options, camera_delay=camera_delay)
    options = replace(options, odometry_scale=odometry_scale or options.odometry_scale)
    options = replace(options, own_turns=own_turns(data, options))
    factor = _odometry_variance_factor(data, options)
    noise = replace(
        options.noise, position=_scaled(options.noise.position, factor),
        heading=_scaled(options.noise.heading, factor))
    return _with_observation_noise(
        replace(options, noise=noise), *errors_near_truth(data, options), noise.range,
        noise.bearing)


def _with_observation_noise(
    options: ConversionOptions, landmarks: ObservationErrors, robots: ObservationErrors,
    least_range_sigma: float = 0.0, least_bearing_sigma: float = 0.0,
) -> ConversionOptions:
    """Return options with the errors of cameras, and the noise of observations if it is known."""
    of_bearings = bearing_offsets(landmarks, least_bearing_sigma)
    of_ranges = range_errors(landmarks, least_range_sigma)
    landmarks = without_systematic_errors(landmarks, of_bearings, of_ranges)
    robots = without_systematic_errors(robots, of_bearings, of_ranges)
    noise = options.noise
    if (~landmarks.outliers()).sum() >= MIN_OBSERVATIONS:
        r, beta = sigmas(landmarks)
        noise = replace(noise, range=r, bearing=beta)
    if (~robots.outliers()).sum() >= MIN_OBSERVATIONS:
        r, beta = sigmas(robots)
        noise = replace(noise, robot_range=r, robot_bearing=beta)
    return replace(options, noise=noise, bearing_offsets=of_bearings, range_errors=of_ranges)


def _correlation_factor(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the factor of the observations' noise over windows in which errors persist."""
    single = replace(options, correlation_factor=1.0)
    observed = [
        record for record in records(data, single, defaultdict(Counter))
        if not isinstance(record, Odometry)]
    errors = normalized_errors(observed, settings(data, single))
    squared = [
        d2 for by_robot in errors.values() for of_robot in by_robot.values() for d2 in of_robot]
    if not squared:
        return options.correlation_factor
    found = noise_scale(squared, DOF['landmark'])
    return max(found.scale, 1.0) if found.is_known() else options.correlation_factor


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
    true = true[np.diff(windows, prepend=-1) > 0]
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


def _odometry_variance_factor(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the ratio of variances of odometry to the stated ones; 1 if it is not known."""
    motions = [
        record for record in records(data, options, defaultdict(Counter))
        if isinstance(record, (Odometry, TruePose))]
    errors = normalized_errors(motions, settings(data, options))
    if 'odometry' not in errors:
        return 1.0
    found = noise_scales(errors['odometry'], DOF['odometry'])['']
    return found.scale ** 2 if found.is_known() else 1.0


def _scaled(variances: tuple[float, float], factor: float) -> tuple[float, float]:
    driving, turning = variances
    return factor * driving, factor * turning


def increments(data: MrclamSet, options: ConversionOptions, window: float) -> WindowIncrements:
    """Return the motion of the robots of a set over windows [s] with ground truth."""
    parts = [_increments(log, options, window) for log in data.logs.values()]
    return WindowIncrements(*(np.vstack(column) for column in zip(*parts)))


def _increments(
    log: RobotLog, options: ConversionOptions, window: float
) -> tuple[Array, Array, Array]:
    stamps, poses = odometry(log, options)
    # Edges, and with them the noise of commands, are the same for any delay that is searched.
    first = max(stamps[0], log.commands.stamps[0] + round(MAX_MOTION_DELAY * NS))
    edges = np.arange(first, stamps[-1], round(window * NS))
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
        return rms(windows.true[:, 2] - _ratio(windows, 2) * windows.measured[:, 2])

    return float(minimize_scalar(error, bounds=(0.0, MAX_MOTION_DELAY), options={'xatol': 1e-3}).x)


def _camera_delay(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the delay [s] with which bearings fit the true poses best, drawn to the usual one."""
    usual, sigma = options.camera_delay, options.noise.bearing
    count = sum(len(log.observations) for log in data.logs.values())

    def cost(delay: float) -> float:
        landmarks, _ = observation_errors(data, delay)
        errors = without_systematic_errors(landmarks, bearing_offsets(landmarks), {})
        inliers = errors.where(~errors.outliers())
        fit = count * np.square(inliers.bearings / sigma).mean() if len(inliers.bearings) else 0.0
        return float(fit + ((delay - usual) / CAMERA_DELAY_SIGMA) ** 2)

    bounds = 0.0, MAX_CAMERA_DELAY
    return float(minimize_scalar(cost, bounds=bounds, options={'xatol': 1e-3}).x)


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


def _growth(
    windows: WindowIncrements, axis: int, seconds: float, usual: tuple[float, float]
) -> tuple[float, float]:
    """
    Return c >= 0 so that squared errors are commanded @ c + standstill noise in the mean.

    Few windows do not tell driving from turning, so the ratio is drawn to that of `usual`.

    """
    squares, constant = np.square(windows.errors()[:, axis]), seconds * STANDSTILL_VARIANCE[axis]
    variances = np.full(len(squares), squares.mean() + constant)
    (factor,), _ = nnls((windows.commanded @ usual)[:, None], squares - constant)
    expected = factor * np.array(usual)
    # A squared error has sqrt(2) times its mean as standard deviation.
    weight = np.sqrt(2.0) / RATIO_SIGMA
    for _ in range(REWEIGHTINGS):
        A, b = windows.commanded / variances[:, None], (squares - constant) / variances
        ratios, _ = nnls(
            np.vstack([A * expected, weight * np.eye(2)]), np.append(b, [weight, weight]))
        c = expected * ratios
        variances = windows.commanded @ c + constant
    return float(c[0]), float(c[1])
