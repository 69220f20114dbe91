# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of several messages: stamps, headers, planar poses and 6x6 covariances."""

import math

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Time as Time, geometry_msgs__msg__Point as Point,
    geometry_msgs__msg__Pose as Pose, geometry_msgs__msg__Quaternion as Quaternion,
    std_msgs__msg__Header as Header)

from fej_slam_ros.core.geometry import Array, wrap
from fej_slam_ros.core.records import NS

#: Last stamp that a message can have [ns].
LAST_STAMP = 2**31 * NS - 1
#: Latest stamp [s] of data of sensors, whose results have somewhat later stamps.
MAX_SECONDS = 2**31 - 1 - 60
#: Hardware ID of the statuses that are of no single robot.
REPORTER = 'fej_slam_ros'

#: Indices of x, y, yaw and of the others in a covariance of x, y, z, rX, rY, rZ.
PLANAR = np.array([0, 1, 5])
UNUSED = np.array([2, 3, 4])
#: Indices of the planar block and of the other variances in the 36 row-major numbers.
PLANAR_BLOCK = 6 * PLANAR[:, None] + PLANAR
UNUSED_VARIANCES = 7 * UNUSED


def to_time(stamp: int) -> Time:
    """Return a stamp [ns] as a message."""
    return Time(sec=stamp // NS, nanosec=stamp % NS)


def from_time(time: Time) -> int:
    """Return the stamp [ns] of a message."""
    return int(time.sec) * NS + int(time.nanosec)


def header(stamp: int, frame: str) -> Header:
    return Header(stamp=to_time(stamp), frame_id=frame)


def to_pose(pose: Array) -> Pose:
    """Return a planar pose (3,) as a message."""
    x, y, phi = pose.tolist()
    return Pose(
        position=Point(x=x, y=y, z=0.0),
        orientation=Quaternion(x=0.0, y=0.0, z=math.sin(phi / 2.0), w=math.cos(phi / 2.0)))


def from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw [rad] of a quaternion of any length."""
    # Exact for x = y = 0: the general formula loses bits of the half angle.
    return wrap(2.0 * math.atan2(z, w) if x == 0.0 == y else math.atan2(
        2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


def to_covariance(P: Array, unused_variance: float) -> Array:
    """Return P (3, 3) as 36 numbers, with an uncorrelated variance of z, roll and pitch."""
    full = np.zeros(36)
    # A product such as D P D^T is symmetric up to rounding; what is symmetric keeps every bit.
    full[PLANAR_BLOCK] = 0.5 * P + 0.5 * P.T
    full[UNUSED_VARIANCES] = unused_variance
    return full


def from_covariance(full: Array) -> Array:
    """Return the planar block (3, 3) of a 6x6 covariance given as 36 numbers."""
    block: Array = np.asarray(full, dtype=float).take(PLANAR_BLOCK)
    return block
