# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records, estimates and diagnostics to messages."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
import json
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys.stores.ros2_jazzy import (
    diagnostic_msgs__msg__DiagnosticArray as DiagnosticArray,
    diagnostic_msgs__msg__DiagnosticStatus as DiagnosticStatus,
    diagnostic_msgs__msg__KeyValue as KeyValue, geometry_msgs__msg__PoseStamped as PoseStamped,
    geometry_msgs__msg__PoseWithCovariance as PoseWithCovariance,
    geometry_msgs__msg__PoseWithCovarianceStamped as PoseWithCovarianceStamped,
    geometry_msgs__msg__Transform as Transform,
    geometry_msgs__msg__TransformStamped as TransformStamped, geometry_msgs__msg__Twist as Twist,
    geometry_msgs__msg__TwistWithCovariance as TwistWithCovariance,
    geometry_msgs__msg__Vector3 as Vector3, nav_msgs__msg__Odometry as OdometryMessage,
    nav_msgs__msg__Path as Path, rosgraph_msgs__msg__Clock as Clock,
    sensor_msgs__msg__LaserScan as LaserScan, sensor_msgs__msg__PointCloud2 as PointCloud2,
    std_msgs__msg__Float64MultiArray as Float64MultiArray,
    std_msgs__msg__MultiArrayDimension as MultiArrayDimension,
    std_msgs__msg__MultiArrayLayout as MultiArrayLayout, std_msgs__msg__String as String,
    std_msgs__msg__UInt8MultiArray as UInt8MultiArray,
    tf2_msgs__msg__TFMessage as TFMessage)

from fej_slam_ros.core.estimates import PoseEstimate, RelativePose
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array, compose, inverse
from fej_slam_ros.core.records import (
    AnyObservation, AnyScan, GpsFix, Odometry, PosePrior, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.rejections import Rejection
from fej_slam_ros.detection.objects import PlanarObservation
from fej_slam_ros.detection.records import AnyRecord, RobotLaserScan, RobotTags
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.messages.cloud import EXACT_POINT, make_cloud
from fej_slam_ros.ros.messages.common import (
    header, LAST_STAMP, REPORTER, to_covariance, to_pose, to_time)
from fej_slam_ros.ros.messages.markers import tag_markers

#: Type of a message of text.
TEXT_TYPE = 'std_msgs/msg/String'
#: Variance of what GPS does not measure [m^2, rad^2]: large enough to carry no information.
UNKNOWN_VARIANCE = 1e6
#: IDs of robots for records without robot-to-robot observations.
NO_IDS: Mapping[str, int] = MappingProxyType({})
NO_MOTION = Twist(linear=Vector3(x=0.0, y=0.0, z=0.0), angular=Vector3(x=0.0, y=0.0, z=0.0))


def clock(stamp: int) -> Clock:
    """Return a tick of simulated time."""
    return Clock(clock=to_time(stamp))


def input_message(
    record: AnyRecord, robot_ids: Mapping[str, int] = NO_IDS
) -> tuple[str, Message]:
    """Return the topic and the message of a record, for the given IDs of observed robots."""
    if isinstance(record, Odometry):
        return f'{record.robot}/odom', odometry(record)
    if isinstance(record, Scan):
        return f'{record.robot}/landmarks', scan(record)
    if isinstance(record, RobotScan):
        return f'{record.robot}/robots', robot_scan(record, robot_ids)
    if isinstance(record, TruePose):
        return f'{record.robot}/ground_truth', true_pose(record)
    if isinstance(record, PosePrior):
        # The empty frame is that of the map, whatever its name.
        estimate = PoseEstimate(record.robot, record.stamp, '', record.pose, record.P)
        return f'{record.robot}/set_pose', pose(estimate, 0.0)
    if isinstance(record, RobotLaserScan):
        return f'{record.robot}/scan', laser_scan(record)
    if isinstance(record, RobotTags):
        return f'{record.robot}/tags', tag_markers(record)
    if isinstance(record, GpsFix):
        return f'{record.robot}/gps', gps_fix(record)
    return 'ground_truth/landmarks', true_landmarks(record)


def odometry(record: Odometry) -> OdometryMessage:
    """Return odometry in the frame ``<robot>/odom``; an unknown covariance is all zero."""
    known = record.twist_covariance
    return _odometry(
        record.stamp, f'{record.robot}/odom', f'{record.robot}/base_link', record.pose,
        np.zeros(36) if known is None else to_covariance(known, 0.0))


def moving(message: OdometryMessage, velocity: Array) -> OdometryMessage:
    """Return odometry with a velocity (3,) of vx, vy and wz in the base frame."""
    vx, vy, wz = velocity.tolist()
    twist = Twist(linear=Vector3(x=vx, y=vy, z=0.0), angular=Vector3(x=0.0, y=0.0, z=wz))
    return replace(message, twist=replace(message.twist, twist=twist))


def true_pose(record: TruePose) -> OdometryMessage:
    """Return the ground truth of a pose, in the frame ``map``."""
    return _odometry(record.stamp, MAP, f'{record.robot}/base_link', record.pose, np.zeros(36))


def gps_fix(record: GpsFix) -> OdometryMessage:
    """Return the GPS position of the antenna ``<robot>/gps`` in ``map``, its heading unknown."""
    message = _odometry(
        record.stamp, MAP, f'{record.robot}/gps', np.append(record.point, 0.0), np.zeros(36))
    P = UNKNOWN_VARIANCE * np.eye(3)
    P[:2, :2] = record.P
    message.pose.covariance = to_covariance(P, UNKNOWN_VARIANCE)
    return message


def scan(record: Scan) -> PointCloud2:
    """Return a scan in the robot's base frame, in float64."""
    return _scan(record, [s.id for s in record.observations])


def robot_scan(record: RobotScan, robot_ids: Mapping[str, int]) -> PointCloud2:
    """Return a scan of other robots in the robot's base frame, in float64."""
    return _scan(record, [robot_ids[s.observed] for s in record.observations])


def laser_scan(record: RobotLaserScan) -> LaserScan:
    """Return a scan in the base frame of its robot."""
    scan = record.scan
    last = scan.angle_min + scan.angle_increment * (len(scan.ranges) - 1)
    intensities = () if scan.intensities is None else scan.intensities
    return LaserScan(
        header=header(record.stamp, f'{record.robot}/base_link'), angle_min=scan.angle_min,
        angle_max=last, angle_increment=scan.angle_increment, time_increment=scan.time_increment,
        scan_time=scan.time_increment * len(scan.ranges), range_min=scan.range_min,
        range_max=scan.range_max, ranges=scan.ranges.astype(np.float32),
        intensities=np.asarray(intensities, np.float32))


def true_landmarks(record: TrueLandmarks) -> PointCloud2:
    """Return the true map."""
    ids = sorted(record.positions)
    points = np.array([record.positions[landmark] for landmark in ids]).reshape(-1, 2)
    return make_cloud(record.stamp, MAP, _columns(ids, points, None, 'f8'))


def pose(estimate: PoseEstimate, unused_variance: float) -> PoseWithCovarianceStamped:
    """Return a pose estimate."""
    covariance = to_covariance(estimate.P, unused_variance)
    return PoseWithCovarianceStamped(
        header=header(estimate.stamp, estimate.frame),
        pose=PoseWithCovariance(pose=to_pose(estimate.pose), covariance=covariance))


def relative_pose(
    relative: RelativePose, base_frame: str, unused_variance: float
) -> PoseWithCovarianceStamped:
    """Return the pose of a robot in the base frame of another."""
    return pose(
        PoseEstimate(relative.observed, relative.stamp, base_frame, relative.pose, relative.P),
        unused_variance)


def fused_odometry(
    estimate: PoseEstimate, base_frame: str, of_robot: OdometryMessage, unused_variance: float
) -> OdometryMessage:
    """Return a pose estimate with the velocity of an odometry message."""
    return replace(
        of_robot, header=header(estimate.stamp, estimate.frame), child_frame_id=base_frame,
        pose=PoseWithCovariance(
            pose=to_pose(estimate.pose), covariance=to_covariance(estimate.P, unused_variance)))


def transforms(
    estimates: Iterable[PoseEstimate], odometry: Mapping[str, Array],
    odometry_frames: Mapping[str, str], post_date: int,
) -> TFMessage:
    """
    Return the transform from each pose's frame to the origin of the robot's odometry frame.

    Parameters
    ----------
    estimates : poses of robots
    odometry : (3,) array for each robot, its pose by odometry alone at the stamp of its estimate
    odometry_frames : name of the odometry frame of each robot
    post_date : duration [ns] from the stamps of the estimates to those of the transforms

    """
    return TFMessage(transforms=[
        _transform(
            min(estimate.stamp + post_date, LAST_STAMP), estimate.frame,
            odometry_frames[estimate.robot],
            compose(estimate.pose, inverse(odometry[estimate.robot])))
        for estimate in estimates])


def path(frame: str, poses: Sequence[tuple[int, Array]]) -> Path:
    """Return a path of stamped poses; its header has the last stamp."""
    return Path(
        header=header(poses[-1][0], frame),
        poses=[PoseStamped(header=header(stamp, frame), pose=to_pose(x)) for stamp, x in poses])


def joint_covariance(robots: Iterable[tuple[str, int]], P: Array) -> Float64MultiArray:
    """Return the joint covariance (3 N, 3 N) of N robots, labelled with names and stamps."""
    size = len(P)
    label = ','.join(f'{name}@{stamp}' for name, stamp in robots)
    rows = MultiArrayDimension(label=label, size=size, stride=size * size)
    columns = MultiArrayDimension(label=label, size=size, stride=size)
    return Float64MultiArray(
        layout=MultiArrayLayout(dim=[rows, columns], data_offset=0), data=P.ravel())


def landmarks(stamp: int, frame: str, ids: Sequence[int], points: Array, P: Array) -> PointCloud2:
    """
    Return a map of points (n, 2) with covariances P (n, 2, 2).

    RViz draws float32 points only, which are up to 0.25 m off in UTM coordinates, so that the
    points are in float64 too.

    """
    columns = _columns(ids, points, P, 'f4')
    exact = {name: ('f8', points[:, k]) for k, name in enumerate(EXACT_POINT)}
    return make_cloud(stamp, frame, columns | exact)


def view_frames(stamp: int, robots: Iterable[str]) -> TFMessage:
    """Return transforms that place each robot's own frame at the origin of ``map``."""
    return TFMessage(transforms=[
        _transform(stamp, MAP, own_frame(robot), np.zeros(3)) for robot in robots])


def rejection(rejected: Rejection) -> DiagnosticStatus:
    """Return a rejected message or observation with its reason."""
    values = {
        'robot': rejected.robot, 'stamp_ns': rejected.stamp, 'id': rejected.id,
        'seen': rejected.observed, 'reason': rejected.reason.value, 'd2': rejected.d2,
        'threshold': rejected.threshold, 'delay_ns': rejected.delay}
    return diagnostic_status(
        f'{REPORTER}: {rejected.robot}', DiagnosticStatus.WARN, rejected.reason.value,
        {name: value for name, value in values.items() if value is not None})


def diagnostic_status(
    name: str, level: int, message: str, values: Mapping[str, object], hardware: str = REPORTER
) -> DiagnosticStatus:
    """Return the status of a robot or of a part of the node."""
    return DiagnosticStatus(
        level=level, name=name, message=message, hardware_id=hardware, values=key_values(values))


def key_values(values: Mapping[str, object]) -> list[KeyValue]:
    """Return the values of a status."""
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def diagnostics(stamp: int, statuses: Iterable[DiagnosticStatus]) -> DiagnosticArray:
    """Return the statuses of all robots and parts of the node."""
    return DiagnosticArray(header=header(stamp, ''), status=list(statuses))


def detections(
    stamp: int, frame: str, ids: Sequence[int], points: Array, R: Array
) -> PointCloud2:
    """Return observed landmarks or robots (n, 2) and their covariances (n, 2, 2)."""
    return make_cloud(stamp, frame, _columns(ids, points, R, 'f8'))


def stacked(
    observations: Sequence[AnyObservation | PlanarObservation]
) -> tuple[Array, Array]:
    """Return points (n, 2) and covariances (n, 2, 2) of observations."""
    return (
        np.array([observation.z for observation in observations]).reshape(-1, 2),
        np.array([observation.R for observation in observations]).reshape(-1, 2, 2))


def byte_array(data: bytes) -> UInt8MultiArray:
    """Return bytes as a message."""
    return UInt8MultiArray(
        layout=MultiArrayLayout(dim=[], data_offset=0), data=np.frombuffer(data, np.uint8))


def json_text(content: object) -> String:
    """Return plain data as text."""
    return String(data=json.dumps(content, sort_keys=True))


def _scan(record: AnyScan, ids: Sequence[int]) -> PointCloud2:
    frame = f'{record.robot}/base_link'
    return detections(record.stamp, frame, ids, *stacked(record.observations))


def _columns(
    ids: Sequence[int], points: Array, P: Array | None, code: str
) -> dict[str, tuple[str, NDArray[np.generic]]]:
    """Return points (n, 2), coded as a numpy type, with IDs, and covariances (n, 2, 2) if any."""
    columns: dict[str, tuple[str, NDArray[np.generic]]] = {
        'x': (code, points[:, 0]), 'y': (code, points[:, 1]), 'z': (code, np.zeros(len(points))),
        'id': ('i4', np.asarray(ids, dtype=int))}
    if P is not None:
        columns |= {
            'var_x': ('f8', P[:, 0, 0]), 'cov_xy': ('f8', P[:, 0, 1]), 'var_y': ('f8', P[:, 1, 1])}
    return columns


def _odometry(
    stamp: int, frame: str, child: str, x: Array, twist_covariance: Array
) -> OdometryMessage:
    return OdometryMessage(
        header=header(stamp, frame), child_frame_id=child,
        pose=PoseWithCovariance(pose=to_pose(x), covariance=np.zeros(36)),
        twist=TwistWithCovariance(twist=NO_MOTION, covariance=twist_covariance))


def _transform(stamp: int, frame: str, child: str, pose: Array) -> TransformStamped:
    at = to_pose(pose)
    translation = Vector3(x=at.position.x, y=at.position.y, z=0.0)
    return TransformStamped(
        header=header(stamp, frame), child_frame_id=child,
        transform=Transform(translation=translation, rotation=at.orientation))
