# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages to records; bad data is rejected here, with a reason.

A message that is rejected as a whole raises `RejectedError`. A rejected observation leaves the
rest of its scan valid.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    diagnostic_msgs__msg__DiagnosticArray as DiagnosticArray, geometry_msgs__msg__Point as Point,
    geometry_msgs__msg__Pose as Pose, geometry_msgs__msg__PoseWithCovarianceStamped as PoseMessage,
    geometry_msgs__msg__Quaternion as Quaternion,
    geometry_msgs__msg__TransformStamped as TransformStamped,
    geometry_msgs__msg__Vector3 as Vector3,
    nav_msgs__msg__Odometry as OdometryMessage, sensor_msgs__msg__PointCloud2 as PointCloud2,
    tf2_msgs__msg__TFMessage as TFMessage)

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, rotation
from fej_slam_ros.core.records import (
    MAX_ID, NO_ID, Observation, Odometry, PosePrior, RobotObservation, RobotScan, Scan,
    TrueLandmarks, TruePose)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages.cloud import (
    BadCloudError, cloud_size, Columns, EXACT_POINT, read_cloud)
from fej_slam_ros.ros.messages.common import from_covariance, from_quaternion, from_time, REPORTER

#: Fields of the coordinates of an observation or landmark.
POINT = ('x', 'y')
#: Values that the status of a robot has if its NIS is reported; so no status of another node is
#: taken for one.
NIS_KEYS = {'received', 'used', 'sightings_used', 'nis', 'nis_dof'}
#: Largest coordinate of a pose or landmark [m], beyond any site; float64 resolves 0.1 um there.
MAX_COORDINATE = 1e9
#: Largest coordinate of an observation [m].
MAX_DISTANCE = 1e6
#: Smallest variance of an observation or pose prior [m^2, rad^2]; smaller ones are input errors
#: and make the innovation covariance singular.
MIN_VARIANCE = 1e-12
#: Largest variance [m^2, rad^2, or per s^2].
MAX_VARIANCE = 1e12
#: Block of a covariance that is unknown.
UNKNOWN_COVARIANCE = [[0.0, 0.0, 0.0]] * 3
#: Tolerance of a quaternion's squared norm, for senders that round.
NORM_TOLERANCE = 1e-3
#: Largest tilt of a robot [rad]; beyond it the planar model does not hold.
MAX_TILT = 0.2
#: Magnitude of a negative eigenvalue, or of an asymmetry, of the correlation matrix that rounding
#: to float32 by the sender explains.
PSD_TOLERANCE = 1e-7
#: Smallest ratio of the determinant of an observation's covariance to its squared trace; below it
#: the rotation into the base frame may make it indefinite by rounding.
PD_TOLERANCE = 1e-14

#: Maximum number of fields of a cloud, and maximum bytes of a scan: of its header, and per point.
#: Points of other programs, such as PCL, have less than 128 bytes.
MAX_FIELDS = 64
MAX_HEADER_BYTES = 65_536
MAX_POINT_BYTES = 256


class RejectedError(Exception):
    """A message is rejected as a whole, for a reason."""

    def __init__(self, reason: RejectionReason) -> None:
        super().__init__(reason.value)
        self.reason = reason


class StaticTransform(NamedTuple):
    """A link of a robot."""

    parent: str
    child: str
    pose: Array  #: (4, 4) array, homogeneous transform of coordinates of the child to the parent


def odometry(message: OdometryMessage, robot: str) -> Odometry:
    """Return odometry as a record; an all-zero twist covariance means unknown."""
    pose, covariance = _planar_pose(message.pose.pose), from_covariance(message.twist.covariance)
    known = None if covariance.tolist() == UNKNOWN_COVARIANCE else checked_covariance(covariance)
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
    if abs(x * x + y * y + z * z + w * w - 1.0) > NORM_TOLERANCE:
        raise RejectedError(RejectionReason.BAD_QUATERNION)
    return np.array([
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y), t.x],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x), t.y],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y), t.z],
        [0.0, 0.0, 0.0, 1.0]])


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
    eigenvalues, vectors = np.linalg.eigh(symmetric / scale)
    asymmetry = np.abs((covariance - symmetric) / scale).max()
    if eigenvalues[0] < -PSD_TOLERANCE or asymmetry > PSD_TOLERANCE:
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    if eigenvalues[0] < 0.0:
        symmetric = vectors @ np.diag(np.maximum(eigenvalues, 0.0)) @ vectors.T * scale
    return symmetric


def true_pose(message: OdometryMessage, robot: str) -> TruePose:
    """Return the ground truth of a pose as a record."""
    return TruePose(robot, from_time(message.header.stamp), _planar_pose(message.pose.pose))


def pose_prior(message: PoseMessage, robot: str, map_frame: str = MAP) -> PosePrior:
    """Return an initial pose as a record; its frame must be `map_frame` or empty."""
    if message.header.frame_id.lstrip('/') not in {'', map_frame}:
        raise RejectedError(RejectionReason.WRONG_FRAME)
    pose = _planar_pose(message.pose.pose)
    P = checked_covariance(from_covariance(message.pose.covariance))
    if np.linalg.eigvalsh(P)[0] < MIN_VARIANCE:
        raise RejectedError(RejectionReason.BAD_COVARIANCE)
    return PosePrior(robot, from_time(message.header.stamp), pose, P)


def true_landmarks(cloud: PointCloud2) -> TrueLandmarks:
    """Return the true map as a record."""
    columns = _columns(cloud)
    points, ids = _points(columns), columns['id'].astype(int).tolist()
    if not np.isfinite(points).all():
        raise RejectedError(RejectionReason.NOT_FINITE)
    if np.abs(points).max(initial=0.0) > MAX_COORDINATE:
        raise RejectedError(RejectionReason.OUT_OF_RANGE)
    if not all(0 <= landmark <= MAX_ID for landmark in ids):
        raise RejectedError(RejectionReason.BAD_ID)
    if len(set(ids)) < len(ids):
        raise RejectedError(RejectionReason.DUPLICATE_ID)
    return TrueLandmarks(dict(zip(ids, points)))


def pose_estimate(message: PoseMessage, robot: str) -> PoseEstimate:
    """Return a published pose estimate."""
    return PoseEstimate(
        robot, from_time(message.header.stamp), message.header.frame_id.lstrip('/'),
        _planar_pose(message.pose.pose), from_covariance(message.pose.covariance))


def map_landmarks(cloud: PointCloud2) -> tuple[NDArray[np.int64], Array, Array]:
    """Return IDs (n,), points (n, 2) and covariances (n, 2, 2) of a published map."""
    columns = _columns(cloud, EXACT_POINT)
    # Maps of 1.0.0 and of other nodes have x and y only.
    points = _points(columns, EXACT_POINT if columns.keys() >= {*EXACT_POINT} else POINT)
    return columns['id'].astype(np.int64), points, _covariances(columns, (0.0, 0.0))


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


def points_beyond(raw: bytes, most: int) -> int | None:
    """
    Return the number of points of a serialised scan of more than `most` points, or their bytes.

    It is None for any other scan, and for a message that is too short, which cannot be decoded.

    """
    try:
        points, fields, size = cloud_size(raw)
    except BadCloudError:
        return None
    is_larger = size > MAX_HEADER_BYTES + most * MAX_POINT_BYTES
    return points if points > most or fields > MAX_FIELDS or is_larger else None


def scan(
    cloud: PointCloud2, robot: RobotSettings, needs_ids: bool = False
) -> tuple[Scan, list[Rejection]]:
    """Return the accepted observations of a scan, in the base frame, and the rejections."""
    def id_fault(landmark: int) -> RejectionReason | None:
        if not NO_ID <= landmark <= MAX_ID:
            return RejectionReason.BAD_ID
        return RejectionReason.NO_IDENTITY if needs_ids and landmark == NO_ID else None

    observations, rejected = _observations(cloud, robot, id_fault, {})
    return Scan(robot.name, from_time(cloud.header.stamp), tuple(observations)), rejected


def robot_scan(
    cloud: PointCloud2, robot: RobotSettings, robots_by_id: Mapping[int, str]
) -> tuple[RobotScan, list[Rejection]]:
    """Return the accepted observations of other robots, in the base frame, and the rejections."""
    def id_fault(observed: int) -> RejectionReason | None:
        if observed == robot.id:
            return RejectionReason.SELF_OBSERVATION
        if not NO_ID <= observed <= MAX_ID:
            return RejectionReason.BAD_ID
        return None if observed in robots_by_id else RejectionReason.UNKNOWN_ROBOT

    observations, rejected = _observations(cloud, robot, id_fault, robots_by_id)
    return RobotScan(robot.name, from_time(cloud.header.stamp), tuple(
        RobotObservation(robots_by_id[s.id], s.z, s.R) for s in observations)), rejected


def observation_faults(z: Array, R: Array) -> list[RejectionReason | None]:
    """Return the rejection reason, or None, of each z (m, 2) with covariance R (m, 2, 2)."""
    faults: list[RejectionReason | None] = [None] * len(z)
    with np.errstate(invalid='ignore', over='ignore', divide='ignore'):
        # R must be positive definite, also after rotation into the base frame.
        xx, xy, yy = R[:, 0, 0], R[:, 0, 1], R[:, 1, 1]
        det, trace = xx * yy - xy * xy, xx + yy
        # The usual scan needs no further test. NaN satisfies no condition.
        least = np.maximum(PD_TOLERANCE * trace, MIN_VARIANCE) * trace
        is_usual = (det > least) & (trace > 0.0) & (trace <= MAX_VARIANCE)
        if np.vdot(z, z) <= MAX_DISTANCE ** 2 and is_usual.all():
            return faults
        checks = (
            (~(np.isfinite(z).all(1) & np.isfinite(R).all((1, 2))), RejectionReason.NOT_FINITE),
            ((np.abs(z).max(1) > MAX_DISTANCE) | (np.abs(R).max((1, 2)) > MAX_VARIANCE),
             RejectionReason.OUT_OF_RANGE),
            ((trace <= 0.0) | (det <= PD_TOLERANCE * trace**2), RejectionReason.BAD_COVARIANCE),
            (det / trace < MIN_VARIANCE, RejectionReason.OUT_OF_RANGE))
    # The first of several faults is reported.
    for failed, reason in reversed(checks):
        for k in np.flatnonzero(failed).tolist():
            faults[k] = reason
    return faults


def _observations(
    cloud: PointCloud2, robot: RobotSettings, id_fault: Callable[[int], RejectionReason | None],
    robots_by_id: Mapping[int, str],
) -> tuple[list[Observation], list[Rejection]]:
    columns = _columns(cloud)
    ids = columns['id'].astype(int).tolist()
    z, R = _points(columns), _covariances(columns, robot.landmark_sigma)
    faults, stamp = observation_faults(z, R), from_time(cloud.header.stamp)
    if any(robot.sensor_pose):
        z, R = _in_base_frame(z, R, np.array(robot.sensor_pose))
    repeated = {id_ for id_, count in Counter(ids).items() if count > 1} - {NO_ID}
    observations, rejected = [], []
    for id_, z_k, R_k, fault in zip(ids, z, R, faults):
        reason = id_fault(id_) or (RejectionReason.DUPLICATE_ID if id_ in repeated else fault)
        if reason is None:
            observations.append(Observation(id_, z_k, R_k))
        else:
            rejected.append(Rejection(
                robot.name, stamp, reason, id=id_, observed=robots_by_id.get(id_)))
    return observations, rejected


def _in_base_frame(z: Array, R: Array, sensor: Array) -> tuple[Array, Array]:
    """Return z (m, 2) and R (m, 2, 2) of a sensor at a pose (3,), in the base frame."""
    C = rotation(sensor[2])
    # Those that are rejected may have any values.
    with np.errstate(invalid='ignore', over='ignore'):
        return (z[:, None] @ C.T)[:, 0] + sensor[:2], C @ R @ C.T


def _static_transform(transform: TransformStamped) -> StaticTransform | RejectionReason:
    try:
        pose = spatial_pose(transform.transform.translation, transform.transform.rotation)
    except RejectedError as rejected:
        return rejected.reason
    return StaticTransform(
        transform.header.frame_id.lstrip('/'), transform.child_frame_id.lstrip('/'), pose)


def _planar_pose(pose: Pose) -> Array:
    p, q = pose.position, pose.orientation
    x, y, z, w = quaternion = q.x, q.y, q.z, q.w
    norm = x * x + y * y + z * z + w * w
    if (x == 0.0 == y and abs(norm - 1.0) <= NORM_TOLERANCE
            and -MAX_COORDINATE <= p.x <= MAX_COORDINATE
            and -MAX_COORDINATE <= p.y <= MAX_COORDINATE
            and -MAX_COORDINATE <= p.z <= MAX_COORDINATE):
        return np.array([p.x, p.y, from_quaternion(*quaternion)])
    position = p.x, p.y, p.z
    if not all(map(math.isfinite, (*position, *quaternion))):
        raise RejectedError(RejectionReason.NOT_FINITE)
    if max(map(abs, position)) > MAX_COORDINATE:
        raise RejectedError(RejectionReason.OUT_OF_RANGE)
    if abs(norm - 1.0) > NORM_TOLERANCE:
        raise RejectedError(RejectionReason.BAD_QUATERNION)
    if 2.0 * math.asin(min(1.0, math.hypot(x, y))) > MAX_TILT:
        raise RejectedError(RejectionReason.TILTED)
    return np.array([p.x, p.y, from_quaternion(*quaternion)], dtype=float)


def _is_diagonal(covariance: Array) -> bool:
    """Return whether a matrix (3, 3) is diagonal and positive definite, the usual case."""
    (xx, a, b), (c, yy, d), (e, f, zz) = covariance.tolist()
    is_usual: bool = (
        a == b == c == d == e == f == 0.0 and 0.0 < xx <= MAX_VARIANCE
        and 0.0 < yy <= MAX_VARIANCE and 0.0 < zz <= MAX_VARIANCE)
    return is_usual


def _columns(cloud: PointCloud2, more: Sequence[str] = ()) -> Columns:
    """Return the columns of a cloud of landmarks, always with x, y and id."""
    try:
        columns = read_cloud(cloud, (*POINT, 'id', 'var_x', 'cov_xy', 'var_y', *more))
    except BadCloudError:
        raise RejectedError(RejectionReason.BAD_CLOUD) from None
    if not cloud.fields and cloud.width * cloud.height == 0:
        columns['x'] = columns['y'] = np.empty(0)
    kinds = {name: column.dtype.kind for name, column in columns.items()}
    has_integer_ids = kinds.pop('id', 'i') in 'iu'
    if not {'x', 'y'} <= kinds.keys() or {*kinds.values()} != {'f'} or not has_integer_ids:
        raise RejectedError(RejectionReason.BAD_CLOUD)
    if 'id' not in columns:
        columns['id'] = np.full(len(columns['x']), NO_ID)
    return columns


def _points(columns: Columns, names: Sequence[str] = POINT) -> Array:
    x, y = (columns[name] for name in names)
    points = np.empty((len(x), 2))
    points[:, 0], points[:, 1] = x, y
    return points


def _covariances(points: Columns, sigma: tuple[float, float]) -> Array:
    """Return the covariances (m, 2, 2) in the sensor frame, diag(sigma^2) where unknown."""
    R = np.zeros((len(points['x']), 2, 2))
    if {'var_x', 'cov_xy', 'var_y'} <= points.keys():
        R[:, 0, 0], R[:, 1, 1] = points['var_x'], points['var_y']
        R[:, 0, 1] = R[:, 1, 0] = points['cov_xy']
    known = R.reshape(-1, 4).any(axis=1)
    if not known.all():
        R[~known] = np.diag(np.square(sigma))
    return R
