# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Motions of a robot between true poses some seconds apart, and the heading errors of these."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.calibration.odometry_trajectory import OdometryTrajectory
from fej_slam_ros.core.calibration.offset_regression import regression
from fej_slam_ros.core.geometry import Array, rotation, Stamps
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import NS, Odometry

#: Minimum and maximum time between two true poses [ns].
MIN_TIME, MAX_TIME = 5 * NS, 10 * NS
#: Minimum number of motions for the direction of travel.
MIN_MOTIONS = 20
#: Usual error of odometry in such a motion [m].
MOTION_SIGMA = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class TrueMotions:
    """Motions of a robot between true poses some seconds apart."""

    firsts: Stamps  #: (n,) array, begins of the motions [ns]
    lasts: Stamps  #: (n,) array, ends [ns]
    true: Array  #: (n, 3) array, by true poses, in the first one
    odometry: OdometryTrajectory

    def by_odometry(self, values: Array) -> Array:
        """Return the motions (n, 3) by odometry without errors (3,)."""
        return self.odometry.without_errors(values).motions(self.firsts, self.lasts)

    def with_headings(self, error: float) -> 'TrueMotions':
        """Return the motions by true headings without an error [rad]."""
        true = self.true.copy()
        true[:, :2] = true[:, :2] @ rotation(error).T
        return replace(self, true=true)

    def heading_error(self, values: Array) -> tuple[float, float]:
        """
        Return the error of the true headings by the direction of travel, and its sigma [rad].

        The frame of a motion-capture system is seldom exactly the base frame. With motions d by
        truth, u by odometry without errors, `values` (3,), and turns phi,

            u = c d + (1 - e^(i phi)) o

        where the angle of c is the error and o the position of what the system locates.

        """
        d, u = (m[:, 0] + 1j * m[:, 1] for m in (self.true, self.by_odometry(values)))
        A = np.column_stack([d, 1.0 - np.exp(1j * self.true[:, 2])])
        fit = regression(lambda _: (A, u), np.full(len(d), MOTION_SIGMA ** -2))
        return (0.0, math.inf) if fit is None else (float(np.angle(fit.c)), fit.sigma)


def true_motions(odometry: Sequence[Odometry], truth: RecordedTruth) -> TrueMotions | None:
    """
    Return the motions of a robot, None if there are fewer than `MIN_MOTIONS`.

    Odometry that stands still shows nothing about the errors of driving: it has no motion.

    """
    intervals = _intervals(odometry, truth)
    if len(intervals) < MIN_MOTIONS:
        return None
    trajectory, ends = OdometryTrajectory.of(odometry), np.array(intervals, np.int64)
    firsts, lasts = ends[trajectory.motions(*ends.T).any(axis=1)].T
    if len(firsts) < MIN_MOTIONS:
        return None
    (_, before), (_, after) = (
        truth.find_all(odometry[0].robot, times.tolist()) for times in (firsts, lasts))
    return TrueMotions(firsts, lasts, models.h_pose(before, after), trajectory)


def _intervals(
    odometry: Sequence[Odometry], truth: RecordedTruth
) -> list[tuple[int, int]]:
    """Return the intervals between stamps of odometry [ns] at whose ends there is ground truth."""
    intervals: list[tuple[int, int]] = []
    begin: int | None = None
    for stamp in sorted({record.stamp for record in odometry}):
        if begin is not None and stamp - begin < MIN_TIME:
            continue
        if truth.covers(odometry[0].robot, stamp):
            # Over a gap the heading may have turned by more than half a turn.
            if begin is not None and stamp - begin <= MAX_TIME:
                intervals.append((begin, stamp))
            begin = stamp
    return intervals
