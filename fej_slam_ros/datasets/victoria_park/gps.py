# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The GPS of Victoria Park, which has gaps and jumps: what can be believed of it.

A fix that its neighbours do not bear out stays in the log, and is doubted.
"""

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, poses_at, rigid_fit
from fej_slam_ros.core.records import NS
from fej_slam_ros.datasets.victoria_park.raw_log import Fixes, Integers
from fej_slam_ros.errors import UserError

#: Where the antenna is in the base frame [m].
ANTENNA: Array = np.array([3.90, 0.46])

#: Fixes bear each other out where they are no farther apart than this [ns], and where the antenna
#: moved as far as the wheels did, to this [m].
MAX_GAP = NS
MAX_JUMP = 1.0
#: So many in a row are not thrown to one place by chance.
MIN_STRETCH = 5
#: The fixes of so many metres tell where a drive begins.
COURSE = 50.0


def antenna_points(stamps: Integers, at: Integers, poses: Array) -> Array:
    """Return where the antenna was (g, 2) at some stamps, given poses (n, 3) at others."""
    x, y, phi = poses_at(stamps, at, poses).T
    c, s = np.cos(phi), np.sin(phi)
    return np.column_stack([
        x + c * ANTENNA[0] - s * ANTENNA[1], y + s * ANTENNA[0] + c * ANTENNA[1]])


def doubted(fixes: Fixes, there: Array) -> Flags:
    """
    Return which fixes (g,) lie between gaps or jumps that are too near each other.

    Parameters
    ----------
    fixes : what GPS says
    there : (g, 2) array, where the wheels had the antenna, in any frame [m]

    """
    moved, drove = (np.hypot(*np.diff(points, axis=0).T) for points in (fixes.points, there))
    is_borne_out = (np.diff(fixes.stamps) <= MAX_GAP) & (np.abs(moved - drove) <= MAX_JUMP)
    stretch = np.append(0, np.cumsum(~is_borne_out))
    is_short: Flags = np.bincount(stretch)[stretch] < MIN_STRETCH
    return is_short


def begin(fixes: Fixes, there: Array, is_doubted: Flags) -> Array:
    """
    Return the pose (3,) in ``map`` at which a drive begins.

    Parameters
    ----------
    fixes : what GPS says
    there : (g, 2) array, where the wheels had the antenna, seen from that pose [m]
    is_doubted : (g,) array, the fixes that do not count

    Raises
    ------
    UserError
        The fixes do not tell.

    """
    has_left = np.hypot(*(there - ANTENNA).T) > COURSE
    # When it comes back, the wheels have lost the way.
    counts = ~is_doubted & ~np.logical_or.accumulate(has_left)
    near = there[counts]
    if not len(near) or np.ptp(near, axis=0).max() < COURSE / 2.0:
        raise UserError(
            f'GPS does not tell where a drive begins: it has too few good fixes in the first'
            f' {COURSE:g} m; fetch aa3_gpsx.mat again')
    return rigid_fit(near, fixes.points[counts])
