# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pose of one robot in the base frame of another."""

import numpy as np

from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimates import RelativePose
from fej_slam_ros.core.geometry import between, perpendicular, rotation


def relative_pose(state: JointState, observer: str, observed: str) -> RelativePose:
    """
    Return the pose of one robot in the base frame of another.

    Common errors cancel: the covariance may be far smaller than that of either pose.

    """
    a, b = state.robots[observer], state.robots[observed]
    x_a, x_b = state.estimate(a), state.estimate(b)
    relative = between(x_a, x_b)
    C = rotation(x_a[2])
    D = np.zeros((3, 6))
    D[:2, :2], D[:2, 2], D[2, 2] = -C.T, -perpendicular(relative[:2]), -1.0
    D[:2, 3:5], D[2, 5] = C.T, 1.0
    P = D @ state.marginal([a, b]) @ D.T
    return RelativePose(observer, observed, max(a.stamp, b.stamp), relative, P)
