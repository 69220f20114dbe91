# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pose of one robot in the base frame of another."""

from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.estimates import RelativePose
from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.models import H_pose


def relative_pose(state: JointState, observer: str, observed: str) -> RelativePose:
    """
    Return the pose of one robot in the base frame of another.

    Common errors cancel: the covariance may be far smaller than that of either pose.

    """
    a, b = state.robots[observer], state.robots[observed]
    x_a, x_b = state.estimate(a), state.estimate(b)
    H = H_pose(x_a[None], x_b[None])[0]
    P = H @ state.marginal([a, b]) @ H.T
    return RelativePose(observer, observed, max(a.stamp, b.stamp), between(x_a, x_b), P)
