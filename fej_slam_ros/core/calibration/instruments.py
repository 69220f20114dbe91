# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Instrumental variables: derivatives of pairs of observations that share no noise with them.

Least squares make the scales of odometry too small, since the noise of odometry is in residuals
and derivatives alike. Velocities shortly before and after the two observations of a pair have
noise of their own, and show how the robot moved between them.
"""

from dataclasses import dataclass, replace

import numpy as np

from fej_slam_ros.core.calibration.observation_pairs import ObservationPairs
from fej_slam_ros.core.geometry import (
    Array, perpendicular, products, rotation, rotations, Stamps)
from fej_slam_ros.core.records import NS

#: Time before, and after, two observations in which velocities predict the motion between them.
PREDICTION_TIME = 3 * NS // 2
#: Half the time [ns] over which motions are compared for their derivative by a delay.
DELAY_STEP = NS // 10


@dataclass(frozen=True, slots=True, eq=False)
class PairMotion:
    """Pairs of observations, and the motion of the robot between both of each."""

    pairs: ObservationPairs
    motion: Array  #: (n, 3) array, in the first base frame, without correction
    #: (n, 3) array, its derivative by the delay of the stamps [m/s, m/s, rad/s]
    by_delay: Array

    def jacobian(self, values: Array) -> Array:
        """
        Return the derivatives (n, 2, 7) of the normalised differences in the first base frame.

        By the `values` (7,): the scales of distances and turns, the turn bias, the bearing bias,
        the position of the sensor, and the delay of its stamps.

        """
        scale, turn, bias, bearing_bias, x, y, _ = values
        position = np.array([x, y])
        u, turned, times = self.motion[:, :2], self.motion[:, 2], _seconds(*self.pairs.stamps)
        B = rotations(turn * turned - bias * times)
        z = products(B, self.pairs.z[1] @ rotation(bearing_bias) + position)
        by_position = np.eye(2) - B
        # A turn rotates the second observation, and the motion by half the angle. A bearing bias
        # rotates the difference of both, which is the motion of the sensor.
        by_turn = -perpendicular(z + 0.5 * scale * u)
        by_bearing = -perpendicular(scale * u - by_position @ position)
        by_delay = turn * by_turn * self.by_delay[:, 2:] - scale * self.by_delay[:, :2]
        J = np.concatenate([np.stack(
            [-u, by_turn * turned[:, None], -by_turn * times[:, None], by_bearing], axis=2),
            by_position, by_delay[:, :, None]], axis=2)
        return J / self.pairs.sigma[:, None, None]


def measured_motion(pairs: ObservationPairs) -> PairMotion:
    """Return the motion between the observations of pairs by odometry."""
    earlier, later = (
        pairs.odometry.motions(*(pairs.stamps + step)) for step in (-DELAY_STEP, DELAY_STEP))
    return PairMotion(
        pairs, pairs.odometry.motions(*pairs.stamps), (earlier - later) / (2.0 * DELAY_STEP / NS))


def predicted_motion(measured: PairMotion) -> PairMotion:
    """Return the same motion by the odometry before the first and after the second observation."""
    odometry, (first, second) = measured.pairs.odometry, measured.pairs.stamps
    start, end = (
        np.clip(stamps, *odometry.stamps[[0, -1]])
        for stamps in (first - PREDICTION_TIME, second + PREDICTION_TIME))
    # In the frame halfway through each turn, motions at equal velocities are proportional.
    moved = sum(
        _with_rotated_start(odometry.motions(*interval), -0.5)
        for interval in ((start, first), (second, end)))
    times = _seconds(start, first) + _seconds(second, end)
    predicted = moved * (_seconds(first, second) / times)[:, None]
    return replace(measured, motion=_with_rotated_start(predicted, 0.5))


def _with_rotated_start(motions: Array, part: float) -> Array:
    """Return motions (n, 3) in frames that are turned back by a part of their turns."""
    rotated = products(rotations(part * motions[:, 2]), motions[:, :2])
    return np.column_stack([rotated, motions[:, 2]])


def _seconds(begin: Stamps, end: Stamps) -> Array:
    """Return the times (n,) between stamps (n,) [s]."""
    return (end - begin) / NS
