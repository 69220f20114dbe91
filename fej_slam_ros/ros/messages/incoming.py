# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages -> records: the edge at which bad data is refused, each time with a reason.

A message that is refused as a whole raises `RefusedError`; a refused observation takes nothing else
of its scan with it.
"""

from collections import Counter
from collections.abc import Callable, Mapping
import math

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    diagnostic_msgs__msg__DiagnosticArray as DiagnosticArray, geometry_msgs__msg__Pose as Pose,
    geometry_msgs__msg__PoseWithCovarianceStamped as PoseMessage,
    nav_msgs__msg__Odometry as OdometryMessage, sensor_msgs__msg__PointCloud2 as PointCloud2)

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, rotation
from fej_slam_ros.core.records import (
    NO_ID, Observation, Odometry, PosePrior, RobotObservation, RobotScan, Scan, TrueLandmarks,
    TruePose)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages.cloud import BadCloudError, read_cloud
from fej_slam_ros.ros.messages.common import from_covariance, from_quaternion, from_time, REPORTER

#: Ids are int32 wherever they are published.
MAX_ID = 2**31 - 1
#: Coordinates beyond this [m] are no measurement.
MAX_COORDINATE = 1e9
MAX_DISTANCE = 1e6
#: Nothing is measured better than this [m^2].
MIN_VARIANCE = 1e-12
#: Variances beyond this [m^2, rad^2, or per s^2] are no covariance.
MAX_VARIANCE = 1e12
#: A quaternion's squared norm may be off by this.
NORM_TOLERANCE = 1e-3
#: A robot tilted by more than this [rad] does not move in the plane.
MAX_TILT = 0.2
#: An eigenvalue of the correlations may be negative by this much: senders compute in float32, too.
PSD_TOLERANCE = 1e-7
#: The smaller variance of an observation is at least this much of the larger one, for rounding.
PD_TOLERANCE = 1e-14


class RejectedError(Exception):
    """A message that is refused as a whole."""

    def __init__(self, reason: RejectionReason) -> None:
        super().__init__(reason.value)
        self.reason = reason


def odometry(message: OdometryMessage, robot: str) -> Odometry:
    """Return odometry as a record; an all-zero covariance of the twist means unknown."""
    pose = _planar_pose(message.pose.pose)
    covariance = from_covariance(message.twist.covariance)
    known = bool(covariance.any())
    return Odometry(
        robot, from_time(message.header.stamp), pose, _checked(covariance) if known else None)


def true_pose(message: OdometryMessage, robot: str) -> TruePose:
    """Return ground truth of a robot as a record."""
    return TruePose(robot, from_time(message.header.stamp), _planar_pose(message.pose.pose))


def given_pose(message: PoseMessage, robot: str) -> PosePrior:
    """Return what somebody says of where a robot is, as a record; it must name ``map``."""
    if message.header.frame_id.lstrip('/') not in {'', MAP}:
        raise RejectedError(RejectionReason.WRONG_FRAME)
    pose, P = _planar_pose(message.pose.pose), _checked(from_covariance(message.pose.covariance))
    if np.linalg.eigvalsh(P)[0] < MIN_VARIANCE:
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    return PosePrior(robot, from_time(message.header.stamp), pose, P)


def true_landmarks(cloud: PointCloud2) -> TrueLandmarks:
    """Return ground truth of the map as a record."""
    columns = _columns(cloud)
    points = np.column_stack([columns['x'], columns['y']]).astype(float)
    ids = columns['id'].astype(int).tolist()
    if not np.isfinite(points).all():
        raise RejectedError(RejectionReason.NOT_FINITE)
    if np.abs(points).max(initial=0.0) > MAX_COORDINATE:
        raise RejectedError(RejectionReason.OUT_OF_RANGE)
    if not all(0 <= number <= MAX_ID for number in ids):
        raise RejectedError(RejectionReason.BAD_ID)
    if len(set(ids)) < len(ids):
        raise RejectedError(RejectionReason.DUPLICATE_ID)
    return TrueLandmarks(dict(zip(ids, points)))


def pose_estimate(message: PoseMessage, robot: str) -> PoseEstimate:
    """Return a pose that an estimator has published."""
    return PoseEstimate(
        robot, from_time(message.header.stamp), message.header.frame_id.lstrip('/'),
        _planar_pose(message.pose.pose), from_covariance(message.pose.covariance))


def map_landmarks(cloud: PointCloud2) -> tuple[NDArray[np.int64], Array, Array]:
    """Return ids (n,), points (n, 2) and covariances (n, 2, 2) of a map that was published."""
    columns = _columns(cloud)
    points = np.column_stack([columns['x'], columns['y']]).astype(float)
    return columns['id'].astype(np.int64), points, _covariances(columns, (0.0, 0.0))


def reports(message: DiagnosticArray) -> dict[str, dict[str, str]]:
    """Return what an estimator or smoother reports of each of its parts, and of each robot."""
    return {
        status.name.removeprefix(f'{REPORTER}: '): {
            value.key: value.value for value in status.values}
        for status in message.status if status.hardware_id == REPORTER}


def nis(message: DiagnosticArray) -> dict[str, tuple[float, int]]:
    """Return NIS of each robot and its degrees of freedom, as an estimator reports them."""
    return {
        name: (float(values['nis']), int(values['nis_dof']))
        for name, values in reports(message).items() if {'nis', 'nis_dof'} <= values.keys()}


def scan(
    cloud: PointCloud2, robot: RobotSettings, needs_ids: bool = False
) -> tuple[Scan, list[Rejection]]:
    """
    Return what is left of a scan, in the base frame, and the observations that were refused.

    Parameters
    ----------
    cloud : what was seen
    robot : who saw
    needs_ids : whether an observation without identity is of no use

    """
    def fault(number: int) -> RejectionReason | None:
        if not NO_ID <= number <= MAX_ID:
            return RejectionReason.BAD_ID
        return RejectionReason.NO_IDENTITY if needs_ids and number == NO_ID else None

    observations, rejected = _observations(cloud, robot, fault, {})
    return Scan(robot.name, from_time(cloud.header.stamp), tuple(observations)), rejected


def robot_scan(
    cloud: PointCloud2, robot: RobotSettings, robots_by_id: Mapping[int, str]
) -> tuple[RobotScan, list[Rejection]]:
    """
    Return what is left of a scan of other robots, and the observations that were refused.

    Parameters
    ----------
    cloud : laid out as a scan of landmarks, with the numbers of robots as ids
    robot : who saw
    robots_by_id : names of all robots by their numbers

    """
    def fault(number: int) -> RejectionReason | None:
        if number == robot.id:
            return RejectionReason.SELF_OBSERVATION
        if not NO_ID <= number <= MAX_ID:
            return RejectionReason.BAD_ID
        return None if number in robots_by_id else RejectionReason.UNKNOWN_ROBOT

    observations, rejected = _observations(cloud, robot, fault, robots_by_id)
    stamp, seen = from_time(cloud.header.stamp), tuple(
        RobotObservation(robots_by_id[s.id], s.z, s.R) for s in observations)
    return RobotScan(robot.name, stamp, seen), rejected


def _observations(
    cloud: PointCloud2, robot: RobotSettings, identity_fault: Callable[[int], RejectionReason | None],
    names: Mapping[int, str],
) -> tuple[list[Observation], list[Rejection]]:
    """Return the observations in a cloud, in the base frame, and those that were refused."""
    stamp = from_time(cloud.header.stamp)
    points = _columns(cloud)
    ids = points['id'].astype(int)
    z = np.column_stack([points['x'], points['y']]).astype(float)
    R = _covariances(points, robot.landmark_sigma)
    occurrences = Counter(ids[ids != NO_ID].tolist())
    faults, sensor = _faults(z, R), np.array(robot.sensor_pose)
    C = rotation(sensor[2])
    observations, rejected = [], []
    for k, number in enumerate(ids.tolist()):
        reason = identity_fault(number) or (
            RejectionReason.DUPLICATE_ID if occurrences[number] > 1 else faults[k])
        if reason is None:
            observations.append(Observation(number, z[k] @ C.T + sensor[:2], C @ R[k] @ C.T))
        else:
            rejected.append(
                Rejection(robot.name, stamp, reason, id=number, seen=names.get(number)))
    return observations, rejected


def _planar_pose(pose: Pose) -> Array:
    p, q = pose.position, pose.orientation
    x, y, z, w = quaternion = q.x, q.y, q.z, q.w
    position = p.x, p.y, p.z
    if not all(map(math.isfinite, (*position, *quaternion))):
        raise RejectedError(RejectionReason.NOT_FINITE)
    if max(map(abs, position)) > MAX_COORDINATE:
        raise RejectedError(RejectionReason.OUT_OF_RANGE)
    if abs(x * x + y * y + z * z + w * w - 1.0) > NORM_TOLERANCE:
        raise RejectedError(RejectionReason.BAD_QUATERNION)
    if 2.0 * math.asin(min(1.0, math.hypot(x, y))) > MAX_TILT:
        raise RejectedError(RejectionReason.TILTED)
    return np.array([p.x, p.y, from_quaternion(*quaternion)], dtype=float)


def _checked(covariance: Array) -> Array:
    """Return a symmetric positive semi-definite matrix, or refuse."""
    if _is_diagonal(covariance):
        return covariance
    if not np.isfinite(covariance).all():
        raise RejectedError(RejectionReason.NOT_FINITE)
    if np.abs(covariance).max() > MAX_VARIANCE:
        raise RejectedError(RejectionReason.OUT_OF_RANGE)
    symmetric: Array = 0.5 * (covariance + covariance.T)
    # Metres and radians have no common scale, so only correlations tell what is a small error.
    variances = np.diag(symmetric)
    if (variances < 0.0).any():
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    sigma = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    scale = np.outer(sigma, sigma)
    eigenvalues, vectors = np.linalg.eigh(symmetric / scale)
    asymmetry = np.abs((covariance - symmetric) / scale).max()
    if eigenvalues[0] < -PSD_TOLERANCE or asymmetry > PSD_TOLERANCE:
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    if eigenvalues[0] < 0.0:
        symmetric = vectors @ np.diag(np.maximum(eigenvalues, 0.0)) @ vectors.T * scale
    return symmetric


def _is_diagonal(covariance: Array) -> bool:
    """Return whether a matrix (3, 3) is of positive variances and no correlations, as most are."""
    (xx, a, b), (c, yy, d), (e, f, zz) = covariance.tolist()
    return a == b == c == d == e == f == 0.0 and all(
        0.0 < variance <= MAX_VARIANCE for variance in (xx, yy, zz))


def _columns(cloud: PointCloud2) -> dict[str, NDArray[np.generic]]:
    """Return the columns of a cloud of landmarks; x, y and id are always there."""
    try:
        columns = read_cloud(cloud, ('x', 'y', 'id', 'var_x', 'cov_xy', 'var_y'))
    except BadCloudError:
        raise RejectedError(RejectionReason.BAD_CLOUD) from None
    if not cloud.fields and cloud.width * cloud.height == 0:
        columns['x'] = columns['y'] = np.empty(0)
    real = [columns[name].dtype.kind == 'f' for name in columns if name != 'id']
    if 'x' not in columns or 'y' not in columns or not all(real):
        raise RejectedError(RejectionReason.BAD_CLOUD)
    columns.setdefault('id', np.full(len(columns['x']), NO_ID))
    if columns['id'].dtype.kind not in 'iu':
        raise RejectedError(RejectionReason.BAD_CLOUD)
    return columns


def _covariances(points: dict[str, NDArray[np.generic]], sigma: tuple[float, float]) -> Array:
    """Return the covariance (m, 2, 2) of each observation in the sensor frame."""
    R = np.zeros((len(points['x']), 2, 2))
    if {'var_x', 'cov_xy', 'var_y'} <= points.keys():
        R[:, 0, 0], R[:, 1, 1] = points['var_x'], points['var_y']
        R[:, 0, 1] = R[:, 1, 0] = points['cov_xy']
    unknown = ~R.any(axis=(1, 2))
    R[unknown] = np.diag(np.square(sigma))
    return R


def _faults(z: Array, R: Array) -> list[RejectionReason | None]:
    """Return why each measurement z (m, 2) with covariance R (m, 2, 2) is refused, if it is."""
    with np.errstate(invalid='ignore', over='ignore', divide='ignore'):
        # The filter divides by R, so an observation must be uncertain in every direction, turned or
        # not.
        det = R[:, 0, 0] * R[:, 1, 1] - R[:, 0, 1] ** 2
        trace = R[:, 0, 0] + R[:, 1, 1]
        found = (
            (~(np.isfinite(z).all(1) & np.isfinite(R).all((1, 2))), RejectionReason.NOT_FINITE),
            ((np.abs(z).max(1) > MAX_DISTANCE) | (np.abs(R).max((1, 2)) > MAX_VARIANCE),
             RejectionReason.OUT_OF_RANGE),
            ((trace <= 0.0) | (det <= PD_TOLERANCE * trace**2), RejectionReason.BAD_COVARIANCE),
            (det / trace < MIN_VARIANCE, RejectionReason.OUT_OF_RANGE))
    faults: list[RejectionReason | None] = [None] * len(z)
    # Of several the first counts.
    for where, reason in reversed(found):
        for k in np.flatnonzero(where).tolist():
            faults[k] = reason
    return faults
