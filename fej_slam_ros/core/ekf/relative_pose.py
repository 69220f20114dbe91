# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pose of one robot in the base frame of another."""

from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import JointState, observation_columns
from fej_slam_ros.core.estimates import RelativePose
from fej_slam_ros.core.geometry import between
from fej_slam_ros.core.models import H_pose


def relative_pose(
    state: JointState, linearization: Linearization, observer: str, observed: str
) -> RelativePose:
    """
    Return the pose of one robot in the base frame of another.

    Common errors cancel, for the pose is linearised like an observation of the other robot: the
    covariance may be far smaller than that of either pose.

    """
    a, b = state.robots[observer], state.robots[observed]
    points = linearization.observation_points(state, observation_columns([a], [b]))
    H = H_pose(points[:, :3], points[:, 3:])[0]
    P = H @ state.marginal([a, b]) @ H.T
    return RelativePose(
        observer, observed, max(a.stamp, b.stamp), between(state.estimate(a), state.estimate(b)),
        P)
