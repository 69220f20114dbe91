# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Odometry of a whole run as a trajectory, also without its systematic errors."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.geometry import Array, Stamps, turning_poses_at
from fej_slam_ros.core.records import NS, Odometry


@dataclass(frozen=True, slots=True, eq=False)
class OdometryTrajectory:
    """Odometry of one robot."""

    stamps: Stamps  #: (k,) array, ascending [ns]
    poses: Array  #: (k, 3) array

    @classmethod
    def of(cls, odometry: Sequence[Odometry]) -> 'OdometryTrajectory':
        """Return the trajectory of records in any order, the first of each stamp."""
        stamps = np.array([record.stamp for record in odometry], np.int64)
        poses = np.array([record.pose for record in odometry]).reshape(-1, 3)
        stamps, first = np.unique(stamps, return_index=True)
        return cls(stamps, poses[first])

    def at(self, stamps: Stamps) -> Array:
        """Return the poses (n, 3) at stamps (n,) [ns] by interpolation, with whole turns."""
        return turning_poses_at(stamps, self.stamps, self.poses)

    def motions(self, begins: Stamps, ends: Stamps) -> Array:
        """Return poses (n, 3) at stamps `ends` in the frames of those at `begins` (n,) [ns]."""
        before, after = self.at(begins), self.at(ends)
        return np.column_stack([
            models.h(before, after[:, :2]), after[:, 2] - before[:, 2]])

    def without_errors(self, values: Array) -> 'OdometryTrajectory':
        """Return the trajectory without errors (3,), from the same first position on."""
        distance, turn, bias = values
        ahead, left, turned = models.h_pose(self.poses[:-1], self.poses[1:]).T
        turns = turn * turned - bias * np.diff(self.stamps) / NS
        headings = self.poses[0, 2] + np.append(0.0, np.cumsum(turns))
        c, s = np.cos(headings[:-1]), np.sin(headings[:-1])
        x, y = (
            start + distance * np.append(0.0, np.cumsum(steps)) for start, steps in (
                (self.poses[0, 0], c * ahead - s * left),
                (self.poses[0, 1], s * ahead + c * left)))
        return replace(self, poses=np.column_stack([x, y, headings]))
