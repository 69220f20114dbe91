# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Instrumental variables: derivatives of pairs of observations that share no noise with them.

Least squares make the scales of odometry too small, since the noise of odometry is in residuals
and derivatives alike. Velocities shortly before and after the two observations of a pair have
noise of their own, and show how the robot moved between them.
"""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.calibration.sensor_pose import ObservationPairs, rotations
from fej_slam_ros.core.geometry import Array, perpendicular, poses_at, Stamps
from fej_slam_ros.core.records import NS

#: Time before, and after, two observations in which velocities predict the motion between them.
PREDICTION_TIME = 3 * NS // 2


@dataclass(frozen=True, slots=True, eq=False)
class PairMotion:
    """Motion of the robot between n pairs of observations, by velocities while it moved."""

    z: Array  #: (n, 2) array, second observations [m]
    times: Array  #: (n,) array, time between both [s]
    velocities: Array  #: (n, 3) array, of the base [m/s, m/s, rad/s]

    def jacobian(self, values: Array) -> Array:
        """
        Return the derivatives (n, 2, 3) of the differences of pairs in the first base frame.

        By the `values` (3,): the scales of distances and turns, and the turn bias.

        """
        scale, turn, bias = values
        dt = self.times
        u = np.einsum('nij,nj->ni', rotations(0.5 * self.velocities[:, 2] * dt),
                      self.velocities[:, :2] * dt[:, None])
        turns = turn * self.velocities[:, 2] * dt - bias * dt
        z = np.einsum('nij,nj->ni', rotations(turns), self.z)
        # A turn rotates the second observation, and the motion by half the angle.
        by_turn = -perpendicular(z + 0.5 * scale * u)
        return np.stack(
            [-u, by_turn * (self.velocities[:, 2] * dt)[:, None], -by_turn * dt[:, None]], axis=2)


def measured_motion(pairs: ObservationPairs) -> PairMotion:
    """Return the motion between the observations of pairs, by odometry without correction."""
    first, second = pairs.stamps
    moved, times = _displacements(pairs, first, second)
    return PairMotion(pairs.z[1], times, moved / times[:, None])


def predicted_motion(pairs: ObservationPairs) -> PairMotion:
    """Return the same motion by the odometry before the first and after the second observation."""
    first, second = pairs.stamps
    (before, of_before), (after, of_after) = (
        _displacements(pairs, *interval) for interval in (
            (first - PREDICTION_TIME, first), (second, second + PREDICTION_TIME)))
    velocities = (before + after) / (of_before + of_after)[:, None]
    return PairMotion(pairs.z[1], (second - first) / NS, velocities)


def _displacements(pairs: ObservationPairs, begin: Stamps, end: Stamps) -> tuple[Array, Array]:
    """Return motions (n, 3) in the frame halfway through the turn, and their times (n,) [s]."""
    begin, end = (np.clip(stamps, pairs.known[0], pairs.known[-1]) for stamps in (begin, end))
    moved = models.h_pose(*(poses_at(stamps, pairs.known, pairs.poses) for stamps in (begin, end)))
    moved[:, :2] = np.einsum('nij,nj->ni', rotations(-0.5 * moved[:, 2]), moved[:, :2])
    return moved, (end - begin) / NS
