# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Clouds to scans and maps; bad data is rejected here, with a reason.

A cloud that is rejected as a whole raises `RejectedError`. A rejected observation leaves the rest
of its scan valid.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import sensor_msgs__msg__PointCloud2 as PointCloud2

from fej_slam_ros.core.geometry import Array, rotation
from fej_slam_ros.core.records import (
    MAX_ID, NO_ID, NS, Observation, RobotObservation, RobotScan, Scan, TrueLandmarks)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages.cloud import BadCloudError, cloud_size, Columns, read_cloud
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.messages.incoming import (
    MAX_COORDINATE, MAX_VARIANCE, MIN_VARIANCE, RejectedError)

#: Fields of the coordinates of an observation or landmark.
POINT = ('x', 'y')
#: Fields of the upper triangle of its covariance, which is known with all of them only.
COVARIANCE = ('var_x', 'cov_xy', 'var_y')
#: Largest coordinate of an observation [m], in the frames of the sensor and of the base.
MAX_DISTANCE = 1e6
#: Smallest ratio of the determinant of an observation's covariance to its squared trace; below it
#: the rotation into the base frame may make it indefinite by rounding.
PD_TOLERANCE = 1e-14

#: Maximum number of fields of a cloud, and maximum bytes of a scan: of its header, and per point.
#: Points of other programs, such as PCL, have less than 128 bytes.
MAX_FIELDS = 64
MAX_HEADER_BYTES = 65_536
MAX_POINT_BYTES = 256


def scan(
    cloud: PointCloud2, robot: RobotSettings, needs_ids: bool = False
) -> tuple[Scan, list[Rejection]]:
    """Return the accepted observations of a scan, in the base frame, and the rejections."""
    def id_fault(landmark: int) -> RejectionReason | None:
        if not NO_ID <= landmark <= MAX_ID:
            return RejectionReason.BAD_ID
        return RejectionReason.NO_IDENTITY if needs_ids and landmark == NO_ID else None

    stamp = _stamp_of(cloud, robot)
    observations, rejected = _observations(cloud, robot, stamp, id_fault, {})
    return Scan(robot.name, stamp, tuple(observations)), rejected


def has_unknown_landmarks(cloud: PointCloud2) -> bool:
    """Return whether a scan has an observation without ID."""
    return bool((checked_columns(cloud)['id'] == NO_ID).any())


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

    stamp = _stamp_of(cloud, robot)
    observations, rejected = _observations(cloud, robot, stamp, id_fault, robots_by_id)
    return RobotScan(robot.name, stamp, tuple(
        RobotObservation(robots_by_id[s.id], s.z, s.R) for s in observations)), rejected


def true_landmarks(cloud: PointCloud2) -> TrueLandmarks:
    """Return the true map as a record."""
    columns = checked_columns(cloud)
    points, ids = points_of(columns), columns['id'].astype(int).tolist()
    if not np.isfinite(points).all():
        raise RejectedError(RejectionReason.NOT_FINITE)
    if np.abs(points).max(initial=0.0) > MAX_COORDINATE:
        raise RejectedError(RejectionReason.OUT_OF_RANGE)
    if not all(0 <= landmark <= MAX_ID for landmark in ids):
        raise RejectedError(RejectionReason.BAD_ID)
    if len(set(ids)) < len(ids):
        raise RejectedError(RejectionReason.DUPLICATE_ID)
    return TrueLandmarks(dict(zip(ids, points)))


def points_beyond(raw: bytes, most: int) -> int | None:
    """
    Return the number of points of a serialised scan of more than `most` points, or their bytes.

    It is None for any other scan, and for a message that is too short, which cannot be decoded.

    """
    try:
        points, fields = cloud_size(raw)
    except BadCloudError:
        return None
    is_larger = len(raw) > MAX_HEADER_BYTES + most * MAX_POINT_BYTES
    return points if points > most or fields > MAX_FIELDS or is_larger else None


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


def checked_columns(cloud: PointCloud2, more: Sequence[str] = ()) -> Columns:
    """Return the columns of a cloud of landmarks, always with x, y and id, and `more` if any."""
    try:
        columns = read_cloud(cloud, (*POINT, 'id', *COVARIANCE, *more))
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


def points_of(columns: Columns, names: Sequence[str] = POINT) -> Array:
    """Return the points (m, 2) in two columns."""
    x, y = (columns[name] for name in names)
    points = np.empty((len(x), 2))
    points[:, 0], points[:, 1] = x, y
    return points


def covariances_of(points: Columns, sigma: tuple[float, float]) -> Array:
    """Return the covariances (m, 2, 2) in the sensor frame, diag(sigma^2) where unknown."""
    R = np.zeros((len(points['x']), 2, 2))
    if points.keys() >= {*COVARIANCE}:
        R[:, 0, 0], R[:, 1, 1] = points['var_x'], points['var_y']
        R[:, 0, 1] = R[:, 1, 0] = points['cov_xy']
    known = R.reshape(-1, 4).any(axis=1)
    if not known.all():
        R[~known] = np.diag(np.square(sigma))
    return R


def _stamp_of(cloud: PointCloud2, robot: RobotSettings) -> int:
    """Return the time [ns] of the observations in a cloud of a robot."""
    return from_time(cloud.header.stamp) - round(robot.sensor_delay * NS)


def _observations(
    cloud: PointCloud2, robot: RobotSettings, stamp: int,
    id_fault: Callable[[int], RejectionReason | None], robots_by_id: Mapping[int, str],
) -> tuple[list[Observation], list[Rejection]]:
    """Return the accepted observations in the base frame as those of landmarks, and rejections."""
    columns = checked_columns(cloud)
    ids = columns['id'].astype(int).tolist()
    z, R = points_of(columns), covariances_of(columns, robot.landmark_sigma)
    faults = observation_faults(z, R)
    if any(robot.sensor_pose):
        z, R = _in_base_frame(z, R, np.array(robot.sensor_pose))
        # By static transforms a sensor may be far from its robot.
        for k in np.flatnonzero(np.abs(z).max(1) > MAX_DISTANCE).tolist():
            faults[k] = faults[k] or RejectionReason.OUT_OF_RANGE
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
