# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frame of a part of a trajectory after an unknown motion, by landmarks observed again."""

import numpy as np

from fej_slam_ros.core.geometry import Array, rigid_fit, transform

#: Number of landmarks that must be observed again, and the largest ratio of their residuals after
#: a rigid fit to their extent.
MIN_FOUND, MAX_MISFIT = 3, 0.2


def frame_by_landmarks(later: Array, earlier: Array) -> Array | None:
    """
    Return the pose (3,) of a frame in an earlier one, None if the landmarks do not show it.

    Parameters
    ----------
    later, earlier : (k, 2) arrays, positions of the same landmarks in both frames [m]

    """
    if len(later) < MIN_FOUND:
        return None
    g = rigid_fit(later, earlier)
    misfit = np.std(transform(g, later) - earlier)
    return g if misfit <= MAX_MISFIT * np.std(earlier - earlier.mean(axis=0)) else None
