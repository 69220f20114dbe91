# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Deserialisation of nav_msgs/Odometry in its usual encoding, in a third of the time of rosbags.

Nine of ten messages of a team are odometry. Everything but the two frames has a fixed size.
"""

from struct import error, Struct

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Time as Time, geometry_msgs__msg__Point as Point,
    geometry_msgs__msg__Pose as Pose, geometry_msgs__msg__PoseWithCovariance as PoseWithCovariance,
    geometry_msgs__msg__Quaternion as Quaternion, geometry_msgs__msg__Twist as Twist,
    geometry_msgs__msg__TwistWithCovariance as TwistWithCovariance,
    geometry_msgs__msg__Vector3 as Vector3, nav_msgs__msg__Odometry as Odometry,
    std_msgs__msg__Header as Header)

#: Start of CDR in little-endian byte order; alignment counts from its end.
LITTLE_ENDIAN = b'\0\1\0\0'
#: Stamp and length of the first frame, length of the second, pose, twist.
_HEAD, _LENGTH, _POSE, _TWIST = Struct('<iII'), Struct('<I'), Struct('<7d'), Struct('<6d')
_COVARIANCE = 36  # numbers of 8 bytes


def read(raw: bytes) -> Odometry | None:
    """Return the message in CDR bytes, None if they must be read in the general way."""
    if raw[:4] != LITTLE_ENDIAN:
        return None
    try:
        sec, nanosec, length = _HEAD.unpack_from(raw, 4)
        frame = raw[16:16 + length]
        at = 16 + -(-length // 4) * 4
        (length,) = _LENGTH.unpack_from(raw, at)
    except error:
        return None
    child = raw[at + 4:at + 4 + length]
    pose_at = 4 + -(-(at + length) // 8) * 8
    covariance_at = pose_at + _POSE.size
    twist_at = covariance_at + 8 * _COVARIANCE
    end = twist_at + _TWIST.size + 8 * _COVARIANCE
    if len(raw) != end or frame[-1:] != b'\0' or child[-1:] != b'\0':
        return None
    x, y, z, *orientation = _POSE.unpack_from(raw, pose_at)
    vx, vy, vz, *angular = _TWIST.unpack_from(raw, twist_at)
    return Odometry(
        Header(Time(sec, nanosec), frame[:-1].decode()), child[:-1].decode(),
        PoseWithCovariance(
            Pose(Point(x, y, z), Quaternion(*orientation)),
            np.frombuffer(raw, '<f8', _COVARIANCE, covariance_at)),
        TwistWithCovariance(
            Twist(Vector3(vx, vy, vz), Vector3(*angular)),
            np.frombuffer(raw, '<f8', _COVARIANCE, end - 8 * _COVARIANCE)))
