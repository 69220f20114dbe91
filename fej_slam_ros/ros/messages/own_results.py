# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Published results back to estimates, for their evaluation."""

from contextlib import suppress
import math

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    diagnostic_msgs__msg__DiagnosticArray as DiagnosticArray,
    geometry_msgs__msg__PoseWithCovarianceStamped as PoseMessage,
    sensor_msgs__msg__PointCloud2 as PointCloud2)

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.ros.messages.cloud import EXACT_POINT
from fej_slam_ros.ros.messages.common import from_covariance, from_time, REPORTER
from fej_slam_ros.ros.messages.incoming import planar_pose
from fej_slam_ros.ros.messages.incoming_clouds import (
    checked_columns, covariances_of, POINT, points_of)

#: Values that the status of a robot has if its NIS is reported; so no status of another node is
#: taken for one.
NIS_KEYS = {'received', 'used', 'sightings_used', 'nis', 'nis_dof'}


def pose_estimate(message: PoseMessage, robot: str) -> PoseEstimate:
    """Return a published pose estimate."""
    return PoseEstimate(
        robot, from_time(message.header.stamp), message.header.frame_id.lstrip('/'),
        planar_pose(message.pose.pose), from_covariance(message.pose.covariance))


def map_landmarks(cloud: PointCloud2) -> tuple[NDArray[np.int64], Array, Array]:
    """Return IDs (n,), points (n, 2) and covariances (n, 2, 2) of a published map."""
    columns = checked_columns(cloud, EXACT_POINT)
    # Maps of 1.0.0 and of other nodes have x and y only.
    points = points_of(columns, EXACT_POINT if columns.keys() >= {*EXACT_POINT} else POINT)
    return columns['id'].astype(np.int64), points, covariances_of(columns, (0.0, 0.0))


def nis(message: DiagnosticArray) -> dict[str, dict[str, tuple[float, int]]]:
    """Return by node the reported NIS sum of each robot and its degrees of freedom."""
    by_node: dict[str, dict[str, tuple[float, int]]] = {}
    for status in message.status:
        node, _, robot = status.name.rpartition(': ')
        values = {value.key: value.value for value in status.values}
        # The hardware of a robot's status is the robot; in 1.0.0 it was REPORTER.
        if node and status.hardware_id in {REPORTER, robot} and values.keys() >= NIS_KEYS:
            # Another node may use the same names.
            with suppress(ValueError):
                total, dof = float(values['nis']), int(values['nis_dof'])
                if math.isfinite(total):
                    by_node.setdefault(node, {})[robot] = total, dof
    return by_node
