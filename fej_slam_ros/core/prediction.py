# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Predicted poses: the last settled pose of a robot, moved on by the odometry received since.

A settled pose is that of a step, which waits until the data of all robots have arrived. A
predicted pose waits for nothing: it depends on what has arrived so far, and the estimator never
uses it.
"""

from bisect import bisect_right

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.geometry import Array, between, compose, perpendicular
from fej_slam_ros.core.ordering.impossible_motion import UNKNOWN_SPEEDS
from fej_slam_ros.core.ordering.odometry_increments import (
    checked_increment, without_odometry_errors)
from fej_slam_ros.core.records import is_too_uncertain, NS, Odometry
from fej_slam_ros.core.settings import RobotSettings

#: Maximum number of increments after the settled pose, ten seconds at 200 Hz; bounds memory and
#: the time of a prediction. With more there is no prediction.
MAX_PENDING = 2000


class PosePredictor:
    """
    Predicts the pose of one robot at its newest odometry.

    The mean is the settled pose composed with the odometry since. The covariance follows eqs. (4)
    to (6) of [Liu] along the increments, as if the filter predicted over each of them in turn.

    """

    def __init__(self) -> None:
        # Odometry from the newest record at or before the settled pose on; for its first ones the
        # poses (3,) without systematic errors, from that of the first on, and for the increments
        # between these the noise G Q G^T (3, 3), both in the odometry frame.
        self._records: list[Odometry] = []
        self._poses: Array = np.empty((0, 3))
        self._noise: Array = np.empty((0, 3, 3))
        self._speeds = UNKNOWN_SPEEDS
        self._settled: PoseEstimate | None = None
        self._settled_odometry: Array = np.zeros(3)

    def add(self, record: Odometry) -> bool:
        """Add accepted odometry; return False, and do not use it, unless it is the newest."""
        if self._records and record.stamp <= self._records[-1].stamp:
            return False
        if len(self._records) > MAX_PENDING:
            self._drop_before(len(self._records))
        self._records.append(record)
        return True

    def settle(self, settled: PoseEstimate, odometry: Array) -> None:
        """Set the pose of the newest step, and the odometry pose (3,) at its stamp."""
        self._settled, self._settled_odometry = settled, odometry
        passed = bisect_right(self._records, settled.stamp, key=lambda record: record.stamp)
        self._drop_before(max(passed - 1, 0))

    def predict(self, settings: RobotSettings) -> PoseEstimate | None:
        """Return the pose at the newest odometry, None if no settled pose leads to it."""
        self._accumulate(settings)
        settled = self._settled
        if settled is None or not self._records:
            return None
        first, newest = self._records[0], self._records[-1]
        if not first.stamp <= settled.stamp <= newest.stamp:
            return None
        # Within the first increment: its beginning may be a record that came too late for this.
        passed = without_odometry_errors(
            between(first.pose, self._settled_odometry), (settled.stamp - first.stamp) / NS,
            settings)
        moved = between(compose(self._poses[0], passed), self._poses[-1])
        pose = models.f(settled.pose, moved)
        Phi = models.Phi(pose[:2] - settled.pose[:2])
        # The rotation from the odometry frame to that of the pose.
        C = models.G(pose[2] - self._poses[-1, 2])
        P = Phi @ settled.P @ Phi.T + C @ self._accumulated_noise(settled.stamp) @ C.T
        return PoseEstimate(settled.robot, newest.stamp, settled.frame, pose, P)

    def _accumulate(self, settings: RobotSettings) -> None:
        """Add the increments since the last prediction; without subscribers there is none."""
        if not len(self._poses) and self._records:
            self._poses = self._records[0].pose[None]
        while len(self._noise) < len(self._records) - 1:
            k = len(self._noise)
            earlier, later = self._records[k:k + 2]
            motion, speeds = checked_increment(earlier, later, self._speeds, settings)
            if motion.impossible or is_too_uncertain(motion.Q):
                # The next prediction starts from a settled pose at or after the later record.
                self._drop_before(k + 1)
                self._poses, self._speeds = later.pose[None], speeds
                continue
            self._speeds = speeds
            begin = self._poses[k]
            G = models.G(begin[2])
            self._poses = np.concatenate([self._poses, compose(begin, motion.u)[None]])
            self._noise = np.concatenate([self._noise, (G @ motion.Q @ G.T)[None]])

    def _accumulated_noise(self, stamp: int) -> Array:
        """Return the covariance (3, 3) of the motion since a stamp, in the odometry frame."""
        if not len(self._noise):
            return np.zeros((3, 3))
        # As a scan divides an increment: its rest has the remaining fraction of the covariance.
        begin, end = self._records[0].stamp, self._records[1].stamp
        N = self._noise.copy()
        N[0] *= (end - stamp) / (end - begin)
        # The sum of Phi N Phi^T with Phi = I + [J d; 0] e^T, e = (0, 0, 1), over the displacements
        # d from the ends of the increments to the newest position.
        Jd = np.zeros((len(N), 3))
        Jd[:, :2] = perpendicular(self._poses[-1, :2] - self._poses[1:, :2])
        linear = Jd.T @ N[:, 2]
        quadratic = (N[:, 2, 2:] * Jd).T @ Jd
        total: Array = N.sum(axis=0) + linear + linear.T + quadratic
        return total

    def _drop_before(self, k: int) -> None:
        """Remove the records before number k and the increments from them."""
        if k > len(self._noise):
            self._speeds = UNKNOWN_SPEEDS
        self._records = self._records[k:]
        self._poses, self._noise = self._poses[k:], self._noise[k:]
