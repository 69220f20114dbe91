# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors of an MRCLAM set's commands against its motion capture.

The motion lags behind the commands. Robots drive by a ratio of the commanded speed, which falls
while they turn, and turn without a command.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from fej_slam_ros.core.geometry import Array, poses_at, Stamps, wrap_all
from fej_slam_ros.core.models import h_pose
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.mrclam.conversion import (
    increment_variances, MAX_COMMAND_HOLD, odometry, slowing_rates, speeds, sums_between,
    unknown_motion)
from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions
from fej_slam_ros.datasets.mrclam.files import MrclamSet, RobotLog
from fej_slam_ros.datasets.mrclam.motion_capture import truth_sigma
from fej_slam_ros.datasets.mrclam.observation_errors import rms, true_poses
from fej_slam_ros.datasets.series import Series

#: Windows [s] over which increments are compared for the delay, and between true poses for the
#: speeds.
DELAY_WINDOW, SPEED_WINDOW = 0.2, 5.0
#: Upper bound of the delay from a command to the motion [s].
MAX_MOTION_DELAY = 0.5
#: Longest window [s] between true poses, in which a heading error stays well below half a turn.
MAX_TRUTH_WINDOW = 60.0
#: Standard deviations among robots of the turns that were not commanded [rad/m, rad/rad], and of
#: the parameters of the forward speed: ratio, and its decrease with the turn rate [1, s/rad].
OWN_TURN_SIGMA = np.array([0.1, 0.1])
FORWARD_SIGMA = np.array([0.1, 1.0])


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


def increments(data: MrclamSet, options: ConversionOptions, window: float) -> WindowIncrements:
    """Return the motion of the robots of a set over windows [s] with ground truth."""
    parts = [_increments(log, options, window) for log in data.logs.values()]
    return WindowIncrements(*(np.vstack(column) for column in zip(*parts)))


def _increments(
    log: RobotLog, options: ConversionOptions, window: float
) -> tuple[Array, Array, Array]:
    """Return the columns of `WindowIncrements` of one robot."""
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
    true, measured = (
        h_pose(x[:-1], x[1:]) for x in (truth, poses_at(edges, stamps, poses)))
    # A robot may turn by more than half a turn in a window.
    measured[:, 2] = np.diff(np.interp(edges, stamps, np.unwrap(poses[:, 2])))
    true[:, 2] = measured[:, 2] + wrap_all(true[:, 2] - measured[:, 2])
    return true[used], measured[used], commanded[used, :2]


def motion_delay(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the delay [s] with which the commands fit the turns of the robots best."""
    def error(delay: float) -> float:
        windows = increments(data, replace(options, motion_delay=delay), DELAY_WINDOW)
        return rms(windows.true[:, 2] - _turn_ratio(windows) * windows.measured[:, 2])

    return float(minimize_scalar(error, bounds=(0.0, MAX_MOTION_DELAY), options={'xatol': 1e-3}).x)


def turn_ratio(data: MrclamSet, options: ConversionOptions) -> float:
    """Return the ratio of true to commanded turns, by least squares over `SPEED_WINDOW`."""
    return _turn_ratio(increments(data, options, SPEED_WINDOW))


def forward_speed(data: MrclamSet, options: ConversionOptions) -> tuple[float, float]:
    """
    Return the ratio of true to commanded forward speed, and its decrease per turn rate [s/rad].

    Weighted least squares over windows between true poses, which may be sparse, with the prior
    `FORWARD_SIGMA`: the displacement is linear in both if the headings are known. These are those
    of odometry, turned by half of what they are off at the end.

    """
    N = np.diag(FORWARD_SIGMA ** -2)
    eta = N @ [options.odometry_scale[0], options.slowdown]
    for log in data.logs.values():
        A, b, weights = _displacements(log, options)
        N += (A.T * weights) @ A
        eta += A.T @ (weights * b)
    ratio, slowdown = np.linalg.solve(N, eta).tolist()
    return ratio, slowdown


def _displacements(log: RobotLog, options: ConversionOptions) -> tuple[Array, Array, Array]:
    """
    Return A, b and weights with A @ [ratio, slowdown] ~ b, all displacements in x, then in y.

    The variance is that of odometry ahead, and of its heading, which sways between true ones,
    across.

    """
    stamps, poses = odometry(log, options)
    true = _in_windows(log, stamps)
    headings, dt = np.unwrap(poses[:, 2]), np.diff(stamps)
    v, turn_rates = log.commands.rows[:-1].T
    steps = v * dt / NS * np.exp(0.5j * (headings[1:] + headings[:-1]))
    slowed = -steps * slowing_rates(turn_rates)
    driven = np.abs(v) * dt / NS
    sums = sums_between(true.stamps, stamps, np.column_stack([
        steps.real, steps.imag, slowed.real, slowed.imag, driven, unknown_motion(log),
        increment_variances(log, options)]))
    at_true = np.interp(true.stamps, stamps, headings)
    off = wrap_all(np.diff(true.rows[:, 2]) - np.diff(at_true))
    turned = np.exp(1j * (true.rows[:-1, 2] - at_true[:-1] + off / 2.0))
    columns = (sums[:, [0, 2]] + 1j * sums[:, [1, 3]]) * turned[:, None]
    x, _, phi = np.square(truth_sigma(log.truth))
    variances = sums[:, 6] + 2.0 * x + np.square(sums[:, 4]) * (sums[:, 8] / 12.0 + phi)
    weights = (np.diff(true.stamps) <= MAX_TRUTH_WINDOW * NS) * (sums[:, 5] == 0.0) / variances
    return (
        np.vstack([columns.real, columns.imag]),
        np.concatenate([np.diff(true.rows[:, 0]), np.diff(true.rows[:, 1])]),
        np.concatenate([weights, weights]))


def _in_windows(log: RobotLog, stamps: Stamps) -> Series:
    """Return the first true pose in each window of odometry."""
    return log.truth.between(stamps[0], stamps[-1]).first_in_windows(
        int(stamps[0]), round(SPEED_WINDOW * NS))


def own_turns(data: MrclamSet, options: ConversionOptions) -> dict[int, tuple[float, float]]:
    """
    Return the turns of each robot that it was not commanded, per metre and per radian.

    Weighted least squares over windows between true poses, which may be sparse, with the prior
    `OWN_TURN_SIGMA`: without true poses they are zero.

    """
    return {robot: _own_turns(log, options) for robot, log in data.logs.items()}


def _own_turns(log: RobotLog, options: ConversionOptions) -> tuple[float, float]:
    stamps, poses = odometry(log, options)
    true, dt = _in_windows(log, stamps), np.diff(stamps)[:, None] / NS
    amounts = np.hstack([
        speeds(log.commands.rows[:-1], options) * dt, increment_variances(log, options)[:, 2:]])
    driven, turned, variances = sums_between(true.stamps, stamps, amounts).T
    headings = poses_at(true.stamps, stamps, poses)[:, 2]
    errors = wrap_all(np.diff(true.rows[:, 2]) - np.diff(headings))
    used = np.diff(true.stamps) <= MAX_TRUTH_WINDOW * NS
    weights = used / (variances + 2.0 * truth_sigma(log.truth)[2] ** 2)
    A = np.column_stack([driven, turned])
    N = (A.T * weights) @ A + np.diag(OWN_TURN_SIGMA ** -2)
    per_metre, per_radian = np.linalg.solve(N, A.T @ (weights * errors)).tolist()
    return per_metre, per_radian


def _turn_ratio(windows: WindowIncrements) -> float:
    """Return the ratio of true to measured turns; 1 for robots that never turn."""
    true, measured = windows.true[:, 2], windows.measured[:, 2]
    turned = float(measured @ measured)
    return float(true @ measured) / turned if turned else 1.0
