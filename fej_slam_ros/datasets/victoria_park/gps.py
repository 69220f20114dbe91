# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The GPS of Victoria Park: outlier detection and the start pose of a drive.

GPS has gaps and jumps. Outliers stay in the log, with a large covariance.
"""

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, poses_at, rigid_fit, Stamps
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.series import Series
from fej_slam_ros.errors import UserError

#: Position of the antenna in the base frame [m].
ANTENNA: Array = np.array([3.90, 0.46])
#: Two fixes in a row are consistent up to this time apart [ns] and up to this difference between
#: the distance by GPS and by dead reckoning [m].
MAX_FIX_GAP = NS
MAX_JUMP = 1.0
#: Minimum number of consistent fixes in a row; that many jumps do not agree by chance.
MIN_STRETCH = 5
#: The start pose is fitted to the fixes within this distance from the start [m].
START_DISTANCE = 50.0


def antenna_points(stamps: Stamps, pose_stamps: Stamps, poses: Array) -> Array:
    """Return the antenna positions (g, 2) at some stamps, from poses (n, 3) at others."""
    x, y, phi = poses_at(stamps, pose_stamps, poses).T
    c, s = np.cos(phi), np.sin(phi)
    return np.column_stack([
        x + c * ANTENNA[0] - s * ANTENNA[1], y + s * ANTENNA[0] + c * ANTENNA[1]])


def outliers(fixes: Series, antenna: Array) -> Flags:
    """
    Return which fixes (g,) lie in a stretch between gaps or jumps that is too short.

    `antenna` (g, 2) are the antenna positions by dead reckoning, in any frame [m].
    """
    by_gps, by_wheels = (
        np.hypot(*np.diff(points, axis=0).T) for points in (fixes.rows, antenna))
    is_consistent = (
        (np.diff(fixes.stamps) <= MAX_FIX_GAP) & (np.abs(by_gps - by_wheels) <= MAX_JUMP))
    stretch = np.append(0, np.cumsum(~is_consistent))
    is_short: Flags = np.bincount(stretch)[stretch] < MIN_STRETCH
    return is_short


def start_pose(fixes: Series, antenna: Array, is_outlier: Flags) -> Array:
    """
    Return the pose (3,) in ``map`` at which a drive starts; too few fixes raise a `UserError`.

    `antenna` (g, 2) are the antenna positions by dead reckoning from that pose [m].
    """
    is_far = np.hypot(*(antenna - ANTENNA).T) > START_DISTANCE
    # Dead reckoning has drifted by the time the car returns.
    is_used = ~is_outlier & ~np.logical_or.accumulate(is_far)
    near = antenna[is_used]
    if not len(near) or np.ptp(near, axis=0).max() < START_DISTANCE / 2.0:
        raise UserError(
            'GPS does not determine the start of a drive: it has too few good fixes in the first'
            f' {START_DISTANCE:g} m; fetch aa3_gpsx.mat again')
    return rigid_fit(near, fixes.rows[is_used])
