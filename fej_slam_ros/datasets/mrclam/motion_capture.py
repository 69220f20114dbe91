# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of the true poses of an MRCLAM set, and those that are wrong."""

from collections import Counter
import math

import numpy as np

from fej_slam_ros.core.calibration.odometry_errors import SIGMA_PER_MEDIAN
from fej_slam_ros.core.geometry import Array, Flags, Indices, pose_difference
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.series import drop, Series

#: Least standard deviations of true poses [m, m, rad].
TRUTH_SIGMA = np.array([0.005, 0.005, 0.01])
#: Longest time [ns] of three successive true poses over which speeds hardly change.
SMOOTH_TIME = NS // 5
#: Largest standard deviations [m, m, rad] that are noise; beyond, units or the robot are wrong.
MAX_NOISE = np.array([0.1, 0.1, 0.1])
#: Motion capture has slipped if it is faster than SPEED_MARGIN times the fastest command by more
#: than MIN_SLIP [m, m, rad], and than NOISE_SIGMAS of its noise; true poses within SLIP_MARGIN
#: [ns] of a slip are dropped, and at most MAX_SLIP_TIME [ns] between two slips if the robot can
#: have moved without them.
SPEED_MARGIN, NOISE_SIGMAS = 1.25, 5.0
MIN_SLIP = np.array([0.02, 0.02, 0.02])
SLIP_MARGIN = NS // 4
MAX_SLIP_TIME = 10 * NS
#: Largest share of true poses near slips; where there are more, units or the robot are wrong, and
#: the rest of them fits by chance.
MAX_SLIPPED = 0.7
UNUSABLE_TRUTH = 'truth that jumps nearly everywhere (is it of this robot, in metres and radians?)'


def noise(truth: Series) -> Array:
    """
    Return the standard deviations [m, m, rad] of independent errors of true poses.

    They are those of second differences, which motion hardly has within `SMOOTH_TIME`; 0 if true
    poses are sparser.

    """
    steps = pose_difference(truth.rows[1:], truth.rows[:-1])
    second = np.diff(steps, axis=0)[truth.stamps[2:] - truth.stamps[:-2] <= SMOOTH_TIME]
    if not len(second):
        return np.zeros(3)
    # The variance of a second difference is 1 + 4 + 1 of that of one error.
    return SIGMA_PER_MEDIAN / math.sqrt(6.0) * np.median(np.abs(second), axis=0)


def truth_sigma(truth: Series) -> Array:
    """Return the standard deviations [m, m, rad] of true poses."""
    sigma: Array = np.maximum(TRUTH_SIGMA, noise(truth))
    return sigma


def without_slips(truth: Series, commands: Series, counts: Counter[str]) -> Series:
    """Return one true pose for each stamp, without those near jumps that no robot can make."""
    repeated = np.diff(truth.stamps, prepend=-1) == 0
    truth = drop(truth, repeated, 'truth repeated at one stamp', counts)
    if not len(commands) or not len(truth):
        return truth
    speeds = SPEED_MARGIN * np.abs(commands.rows).max(axis=0)
    before, after = _slips(truth, speeds)
    begins = np.sort(truth.stamps[before] - SLIP_MARGIN)
    ends = np.sort(truth.stamps[after] + SLIP_MARGIN)
    inside = np.searchsorted(begins, truth.stamps) - np.searchsorted(ends, truth.stamps, 'right')
    slipped = inside > 0
    if slipped.sum() > MAX_SLIPPED * len(truth):
        return drop(truth, np.ones(len(truth), dtype=bool), UNUSABLE_TRUTH, counts)
    return drop(truth, slipped, 'truth at a jump', counts)


def _slips(truth: Series, speeds: Array) -> tuple[Indices, Indices]:
    """
    Return the last true pose before each slip and the first one after it, (k,) arrays.

    `speeds` (2,) are the largest that the robot can have [m/s, rad/s].

    """
    sigma, (v, w) = noise(truth), speeds
    # A step has the errors of two poses.
    usual = math.sqrt(2.0) * NOISE_SIGMAS * np.where(sigma <= MAX_NOISE, sigma, 0.0)
    least = np.maximum(MIN_SLIP, usual)

    def is_jump(before: Indices, after: Indices) -> Flags:
        steps = np.abs(pose_difference(truth.rows[after], truth.rows[before]))
        dt = (truth.stamps[after] - truth.stamps[before]) / NS
        jumps: Flags = (steps > least + dt[:, None] * [v, v, w]).any(axis=1)
        return jumps

    rows = np.arange(len(truth))
    jumps = np.flatnonzero(is_jump(rows[:-1], rows[1:]))
    # Either of the two poses at a jump may be wrong. What lies between two of them is displaced if
    # the robot can have moved without it.
    before, after = jumps[:-1], jumps[1:] + 1
    is_displaced = ~is_jump(before, after) & (
        truth.stamps[after] - truth.stamps[before] <= MAX_SLIP_TIME)
    return np.append(jumps, before[is_displaced]), np.append(jumps + 1, after[is_displaced])
