# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Odometry, poses and static transforms to records; bad data is rejected here, with a reason.

A message that is rejected as a whole raises `RejectedError`.
"""

import math
from typing import NamedTuple

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Point as Point, geometry_msgs__msg__Pose as Pose,
    geometry_msgs__msg__PoseWithCovarianceStamped as PoseMessage,
    geometry_msgs__msg__Quaternion as Quaternion,
    geometry_msgs__msg__TransformStamped as TransformStamped,
    geometry_msgs__msg__Vector3 as Vector3, nav_msgs__msg__Odometry as OdometryMessage,
    tf2_msgs__msg__TFMessage as TFMessage)

from fej_slam_ros.core.definiteness import PSD_TOLERANCE
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Odometry, PosePrior, TruePose
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.messages.common import from_covariance, from_quaternion, from_time

#: Largest coordinate of a pose, landmark or frame [m], beyond any site; float64 resolves 0.1 um
#: there.
MAX_COORDINATE = 1e9
#: Smallest variance of an observation or pose prior [m^2, rad^2]; smaller ones are input errors
#: and make the innovation covariance singular.
MIN_VARIANCE = 1e-12
#: Largest variance [m^2, rad^2, or per s^2].
MAX_VARIANCE = 1e12
#: Block of a covariance that is unknown.
UNKNOWN_COVARIANCE = [[0.0, 0.0, 0.0]] * 3
#: Tolerance of a quaternion's squared norm, for senders that round; that of tf2.
NORM_TOLERANCE = 1e-2
#: Largest tilt of a robot [rad]; beyond it the planar model does not hold.
MAX_TILT = 0.2


class RejectedError(Exception):
    """A message is rejected as a whole, for a reason."""

    def __init__(self, reason: RejectionReason) -> None:
        super().__init__(reason.value)
        self.reason = reason


class StaticTransform(NamedTuple):
    """The constant pose of a frame of a robot in another one."""

    parent: str
    child: str
    pose: Array  #: (4, 4) array, homogeneous transform of coordinates of the child to the parent


def odometry(message: OdometryMessage, robot: str, with_covariance: bool = True) -> Odometry:
    """Return odometry as a record; an all-zero twist covariance, or one not used, is unknown."""
    pose, known = planar_pose(message.pose.pose), None
    if with_covariance:
        covariance = from_covariance(message.twist.covariance)
        if covariance.tolist() != UNKNOWN_COVARIANCE:
            known = checked_covariance(covariance)
    return Odometry(robot, from_time(message.header.stamp), pose, known)


def static_transforms(message: TFMessage) -> tuple[list[StaticTransform], list[RejectionReason]]:
    """Return static transforms as values, and the reasons why others are rejected."""
    results = [_static_transform(transform) for transform in message.transforms]
    return (
        [result for result in results if isinstance(result, StaticTransform)],
        [result for result in results if isinstance(result, RejectionReason)])


def spatial_pose(t: Vector3 | Point, q: Quaternion) -> Array:
    """Return a position and an orientation as a homogeneous transform (4, 4)."""
    x, y, z, w = quaternion = q.x, q.y, q.z, q.w
    if not all(map(math.isfinite, (t.x, t.y, t.z, *quaternion))):
        raise RejectedError(RejectionReason.NOT_FINITE)
    norm = x * x + y * y + z * z + w * w
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise RejectedError(RejectionReason.BAD_QUATERNION)
    s = 2.0 / norm
    return np.array([
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y), t.x],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x), t.y],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y), t.z],
        [0.0, 0.0, 0.0, 1.0]])


def planar_pose(pose: Pose) -> Array:
    """Return x, y and yaw (3,) of a pose that is valid and hardly tilted."""
    p, q = pose.position, pose.orientation
    x, y, z, w = quaternion = q.x, q.y, q.z, q.w
    norm = x * x + y * y + z * z + w * w
    if not (x == 0.0 == y and abs(norm - 1.0) <= NORM_TOLERANCE
            and -MAX_COORDINATE <= p.x <= MAX_COORDINATE
            and -MAX_COORDINATE <= p.y <= MAX_COORDINATE
            and -MAX_COORDINATE <= p.z <= MAX_COORDINATE):
        position = p.x, p.y, p.z
        if not all(map(math.isfinite, (*position, *quaternion))):
            raise RejectedError(RejectionReason.NOT_FINITE)
        if max(map(abs, position)) > MAX_COORDINATE:
            raise RejectedError(RejectionReason.OUT_OF_RANGE)
        if abs(norm - 1.0) > NORM_TOLERANCE:
            raise RejectedError(RejectionReason.BAD_QUATERNION)
        if 2.0 * math.asin(min(1.0, math.hypot(x, y) / math.sqrt(norm))) > MAX_TILT:
            raise RejectedError(RejectionReason.TILTED)
    return np.array([p.x, p.y, from_quaternion(*quaternion)])


def planar_mount(pose: Array) -> tuple[float, float, float]:
    """Return x, y and yaw of the pose (4, 4) of an upright sensor in the base frame."""
    if pose[2, 2] < math.cos(MAX_TILT):
        raise RejectedError(RejectionReason.TILTED)
    return float(pose[0, 3]), float(pose[1, 3]), math.atan2(pose[1, 0], pose[0, 0])


def checked_covariance(covariance: Array) -> Array:
    """Return a covariance (3, 3), made symmetric positive semi-definite within the tolerance."""
    if _is_diagonal(covariance):
        return covariance
    if not np.isfinite(covariance).all():
        raise RejectedError(RejectionReason.NOT_FINITE)
    if np.abs(covariance).max() > MAX_VARIANCE:
        raise RejectedError(RejectionReason.OUT_OF_RANGE)
    symmetric: Array = 0.5 * (covariance + covariance.T)
    # Metres and radians have no common scale, so tolerances apply to the correlations.
    variances = np.diag(symmetric)
    if (variances < 0.0).any():
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    sigma = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    scale = np.outer(sigma, sigma)
    # No correlation exceeds 1; divided by tiny variances it may be no number.
    if (np.abs(covariance) > 2.0 * scale).any():
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    eigenvalues, vectors = np.linalg.eigh(symmetric / scale)
    asymmetry = np.abs((covariance - symmetric) / scale).max()
    if eigenvalues[0] < -PSD_TOLERANCE or asymmetry > PSD_TOLERANCE:
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    if eigenvalues[0] < 0.0:
        symmetric = vectors @ np.diag(np.maximum(eigenvalues, 0.0)) @ vectors.T * scale
    return symmetric


def true_pose(message: OdometryMessage, robot: str) -> TruePose:
    """Return the ground truth of a pose as a record."""
    return TruePose(robot, from_time(message.header.stamp), planar_pose(message.pose.pose))


def pose_prior(message: PoseMessage, robot: str, map_frame: str) -> PosePrior:
    """Return an initial pose as a record; its frame must be `map_frame` or empty."""
    if message.header.frame_id.lstrip('/') not in {'', map_frame}:
        raise RejectedError(RejectionReason.WRONG_FRAME)
    pose = planar_pose(message.pose.pose)
    P = checked_covariance(from_covariance(message.pose.covariance))
    if np.linalg.eigvalsh(P)[0] < MIN_VARIANCE:
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    return PosePrior(robot, from_time(message.header.stamp), pose, P)


def _static_transform(transform: TransformStamped) -> StaticTransform | RejectionReason:
    try:
        pose = spatial_pose(transform.transform.translation, transform.transform.rotation)
    except RejectedError as rejected:
        return rejected.reason
    if np.abs(pose[:3, 3]).max() > MAX_COORDINATE:
        return RejectionReason.OUT_OF_RANGE
    return StaticTransform(
        transform.header.frame_id.lstrip('/'), transform.child_frame_id.lstrip('/'), pose)


def _is_diagonal(covariance: Array) -> bool:
    """Return whether a matrix (3, 3) is diagonal and positive definite, the usual case."""
    (xx, a, b), (c, yy, d), (e, f, zz) = covariance.tolist()
    is_usual: bool = (
        a == b == c == d == e == f == 0.0 and 0.0 < xx <= MAX_VARIANCE
        and 0.0 < yy <= MAX_VARIANCE and 0.0 < zz <= MAX_VARIANCE)
    return is_usual
