# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records, estimates and reports -> messages."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Duration as Duration,
    diagnostic_msgs__msg__DiagnosticArray as DiagnosticArray,
    diagnostic_msgs__msg__DiagnosticStatus as DiagnosticStatus,
    diagnostic_msgs__msg__KeyValue as KeyValue, geometry_msgs__msg__Point as Point,
    geometry_msgs__msg__PoseStamped as PoseStamped,
    geometry_msgs__msg__PoseWithCovariance as PoseWithCovariance,
    geometry_msgs__msg__PoseWithCovarianceStamped as PoseWithCovarianceStamped,
    geometry_msgs__msg__Transform as Transform,
    geometry_msgs__msg__TransformStamped as TransformStamped, geometry_msgs__msg__Twist as Twist,
    geometry_msgs__msg__TwistWithCovariance as TwistWithCovariance,
    geometry_msgs__msg__Vector3 as Vector3, nav_msgs__msg__Odometry as OdometryMessage,
    nav_msgs__msg__Path as Path, rosgraph_msgs__msg__Clock as Clock,
    sensor_msgs__msg__CompressedImage as CompressedImage,
    sensor_msgs__msg__PointCloud2 as PointCloud2, std_msgs__msg__ColorRGBA as ColorRGBA,
    std_msgs__msg__Float64MultiArray as Float64MultiArray,
    std_msgs__msg__MultiArrayDimension as MultiArrayDimension,
    std_msgs__msg__MultiArrayLayout as MultiArrayLayout, tf2_msgs__msg__TFMessage as TFMessage,
    visualization_msgs__msg__Marker as Marker, visualization_msgs__msg__MarkerArray as MarkerArray,
    visualization_msgs__msg__MeshFile as MeshFile)

from fej_slam_ros.core.estimates import PoseEstimate, RelativePose, StepResult
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array, between, compose, ellipse
from fej_slam_ros.core.records import (
    AnyScan, GpsFix, Odometry, PosePrior, Record, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.rejections import Rejection
from fej_slam_ros.palette import LANDMARKS, NAMES, NOT_JOINED, rgb, robot_colour
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.messages.cloud import make_cloud
from fej_slam_ros.ros.messages.common import header, REPORTER, to_covariance, to_pose, to_time

#: Ellipses of markers are drawn at so many standard deviations.
ELLIPSE_SIGMAS = 3.0
#: Of what a sensor does not measure, or whose velocity is not told.
UNKNOWN_VARIANCE = 1e6
#: For records in which no robot sees another.
NO_IDS: Mapping[str, int] = MappingProxyType({})
NO_MOTION = Twist(linear=Vector3(x=0.0, y=0.0, z=0.0), angular=Vector3(x=0.0, y=0.0, z=0.0))


def clock(stamp: int) -> Clock:
    """Return a tick of simulated time."""
    return Clock(clock=to_time(stamp))


def input_message(
    record: Record | GpsFix, robot_ids: Mapping[str, int] = NO_IDS
) -> tuple[str, Message]:
    """
    Return the topic that a record is published on, and its message.

    Parameters
    ----------
    record : what was measured
    robot_ids : numbers of the robots that may have been seen, by name

    """
    if isinstance(record, Odometry):
        return f'{record.robot}/odom', odometry(record)
    if isinstance(record, Scan):
        return f'{record.robot}/landmarks', scan(record)
    if isinstance(record, RobotScan):
        return f'{record.robot}/robots', robot_scan(record, robot_ids)
    if isinstance(record, TruePose):
        return f'{record.robot}/ground_truth', true_pose(record)
    if isinstance(record, PosePrior):
        told = PoseEstimate(record.robot, record.stamp, MAP, record.pose, record.P)
        return f'{record.robot}/set_pose', pose(told, 0.0)
    if isinstance(record, GpsFix):
        return f'{record.robot}/gps', gps_fix(record)
    return 'ground_truth/landmarks', true_landmarks(record)


def odometry(record: Odometry) -> OdometryMessage:
    """Return odometry in the frame ``<robot>/odom``; an unknown covariance is all zero."""
    known = record.twist_covariance
    return _odometry(
        record.stamp, f'{record.robot}/odom', f'{record.robot}/base_link', record.pose,
        np.zeros(36) if known is None else to_covariance(known, 0.0))


def true_pose(record: TruePose) -> OdometryMessage:
    """Return ground truth of a robot in the frame ``map``."""
    child = f'{record.robot}/base_link'
    return _odometry(record.stamp, MAP, child, record.pose, np.zeros(36))


def gps_fix(record: GpsFix) -> OdometryMessage:
    """Return where GPS has the antenna ``<robot>/gps`` in the frame ``map``, heading unknown."""
    message = _odometry(
        record.stamp, MAP, f'{record.robot}/gps', np.append(record.point, 0.0), np.zeros(36))
    P = UNKNOWN_VARIANCE * np.eye(3)
    P[:2, :2] = record.P
    message.pose.covariance = to_covariance(P, UNKNOWN_VARIANCE)
    return message


def scan(record: Scan) -> PointCloud2:
    """Return a scan in the robot's base frame, in float64."""
    return _observations(record, [s.id for s in record.observations])


def robot_scan(record: RobotScan, robot_ids: Mapping[str, int]) -> PointCloud2:
    """Return a scan of other robots in the robot's base frame, in float64."""
    return _observations(record, [robot_ids[s.seen] for s in record.observations])


def true_landmarks(record: TrueLandmarks) -> PointCloud2:
    """Return ground truth of the map."""
    ids = np.array(sorted(record.positions), dtype=int)
    xy = np.array([record.positions[number] for number in ids.tolist()]).reshape(-1, 2)
    return make_cloud(record.stamp, MAP, {
        'x': ('f8', xy[:, 0]), 'y': ('f8', xy[:, 1]), 'z': ('f8', np.zeros(len(xy))),
        'id': ('i4', ids)})


def pose(estimate: PoseEstimate, unused_variance: float) -> PoseWithCovarianceStamped:
    """Return a pose estimate."""
    return PoseWithCovarianceStamped(
        header=header(estimate.stamp, estimate.frame),
        pose=PoseWithCovariance(
            pose=to_pose(estimate.pose), covariance=to_covariance(estimate.P, unused_variance)))


def relative_pose(seen: RelativePose, unused_variance: float) -> PoseWithCovarianceStamped:
    """Return the pose of a robot in the base frame of another."""
    return PoseWithCovarianceStamped(
        header=header(seen.stamp, f'{seen.observer}/base_link'),
        pose=PoseWithCovariance(
            pose=to_pose(seen.pose), covariance=to_covariance(seen.P, unused_variance)))


def transforms(result: StepResult, odometry_frames: Mapping[str, str]) -> TFMessage:
    """Return where the origin of each robot's odometry lies, by the robot's pose and odometry."""
    return TFMessage(transforms=[
        TransformStamped(
            header=header(estimate.stamp, estimate.frame),
            child_frame_id=odometry_frames[estimate.robot],
            transform=_transform(compose(
                estimate.pose, between(result.odometry[estimate.robot], np.zeros(3)))))
        for estimate in result.poses])


def path(frame: str, poses: Sequence[tuple[int, Array]]) -> Path:
    """Return a path of stamped poses, the last stamp in its header."""
    return Path(
        header=header(poses[-1][0], frame),
        poses=[PoseStamped(header=header(stamp, frame), pose=to_pose(x)) for stamp, x in poses])


def joint_covariance(joined: Sequence[tuple[str, int]], P: Array) -> Float64MultiArray:
    """Return the joint covariance (3 N, 3 N) of N robots, labelled ``name@stamp``."""
    size = len(P)
    label = ','.join(f'{name}@{stamp}' for name, stamp in joined)
    rows = MultiArrayDimension(label=label, size=size, stride=size * size)
    columns = MultiArrayDimension(label=label, size=size, stride=size)
    return Float64MultiArray(
        layout=MultiArrayLayout(dim=[rows, columns], data_offset=0),
        data=P.ravel())


def landmarks(stamp: int, frame: str, ids: Sequence[int], points: Array, P: Array) -> PointCloud2:
    """
    Return a map of points (n, 2) with covariances P (n, 2, 2).

    Coordinates are float32, as RViz draws no other.

    """
    return make_cloud(stamp, frame, {
        'x': ('f4', points[:, 0]), 'y': ('f4', points[:, 1]), 'z': ('f4', np.zeros(len(points))),
        'id': ('i4', np.asarray(ids, dtype=int)), 'var_x': ('f8', P[:, 0, 0]),
        'cov_xy': ('f8', P[:, 0, 1]), 'var_y': ('f8', P[:, 1, 1])})


def markers(
    stamp: int, robots: Sequence[tuple[int, PoseEstimate, Array]],
    maps: Sequence[tuple[str, Array, Array]]
) -> MarkerArray:
    """
    Return robots with names and paths, landmarks, and the 3-sigma ellipses of both.

    What is in ``map`` has colours; what is in another frame is grey, and in namespaces that name
    the frame, so that it can be hidden.

    Parameters
    ----------
    robots : place in the order of robots, newest pose and path (n, 3) of each
    maps : frame, landmarks (n, 2) and their covariances (n, 2, 2) of each

    """
    drawn = [_marker(stamp, MAP, 'all', 0, Marker.DELETEALL, Marker.ARROW, np.zeros(3))]
    for place, now, way in robots:
        drawn += _robot(stamp, place, now, way)
    for frame, points, P in maps:
        drawn += _landmarks(stamp, frame, points, P)
    # The type store calls the same class by the name of an older release.
    return MarkerArray(markers=drawn)  # type: ignore[arg-type]


def view_frames(stamp: int, robots: Iterable[str]) -> TFMessage:
    """Return transforms that draw each robot's own frame at the origin of ``map``."""
    return TFMessage(transforms=[
        TransformStamped(
            header=header(stamp, MAP), child_frame_id=own_frame(robot),
            transform=_transform(np.zeros(3)))
        for robot in robots])


def rejection(rejected: Rejection) -> DiagnosticStatus:
    """Return a refused message or observation with its reason."""
    told = {
        'robot': rejected.robot, 'stamp_ns': rejected.stamp, 'id': rejected.id, 'seen': rejected.seen,
        'reason': rejected.reason.value, 'd2': rejected.d2, 'threshold': rejected.threshold,
        'delay_ns': rejected.delay}
    return diagnostic_status(
        rejected.robot, DiagnosticStatus.WARN, rejected.reason.value,
        {name: value for name, value in told.items() if value is not None})


def diagnostic_status(
    name: str, level: int, message: str, values: Mapping[str, object]
) -> DiagnosticStatus:
    """Return the state of one part of the estimator."""
    return DiagnosticStatus(
        level=level, name=f'{REPORTER}: {name}', message=message, hardware_id=REPORTER,
        values=[KeyValue(key=key, value=str(value)) for key, value in values.items()])


def diagnostics(stamp: int, statuses: Iterable[DiagnosticStatus]) -> DiagnosticArray:
    """Return the state of all parts of the estimator."""
    return DiagnosticArray(header=header(stamp, ''), status=list(statuses))


def _observations(record: AnyScan, ids: Sequence[int]) -> PointCloud2:
    z = np.array([s.z for s in record.observations]).reshape(-1, 2)
    R = np.array([s.R for s in record.observations]).reshape(-1, 2, 2)
    return make_cloud(record.stamp, f'{record.robot}/base_link', {
        'x': ('f8', z[:, 0]), 'y': ('f8', z[:, 1]), 'z': ('f8', np.zeros(len(z))),
        'id': ('i4', np.array(ids, dtype=int)), 'var_x': ('f8', R[:, 0, 0]),
        'cov_xy': ('f8', R[:, 0, 1]), 'var_y': ('f8', R[:, 1, 1])})


def _odometry(
    stamp: int, frame: str, child: str, x: Array, twist_covariance: Array
) -> OdometryMessage:
    return OdometryMessage(
        header=header(stamp, frame), child_frame_id=child,
        pose=PoseWithCovariance(pose=to_pose(x), covariance=np.zeros(36)),
        twist=TwistWithCovariance(twist=NO_MOTION, covariance=twist_covariance))


def _transform(pose: Array) -> Transform:
    at = to_pose(pose)
    return Transform(
        translation=Vector3(x=at.position.x, y=at.position.y, z=0.0), rotation=at.orientation)


def _robot(stamp: int, place: int, now: PoseEstimate, way: Array) -> Iterator[Marker]:
    colour = robot_colour(place)
    arrow = _drawn(stamp, now.frame, 'robots', place, Marker.ARROW, now.pose, colour)
    arrow.scale = Vector3(x=1.0, y=0.25, z=0.25)
    yield arrow
    name = _drawn(stamp, now.frame, 'names', place, Marker.TEXT_VIEW_FACING, now.pose, NAMES)
    name.text = now.robot
    name.scale.z = name.pose.position.z = 1.5
    name.pose.position.y += 1.5
    yield name
    if len(way) > 1:  # RViz refuses a line of a single point
        path = _drawn(stamp, now.frame, 'paths', place, Marker.LINE_STRIP, np.zeros(3), colour)
        path.scale = Vector3(x=0.1, y=0.0, z=0.0)
        path.points = _points(way)
        yield path
    yield _ellipse(stamp, now.frame, 'robot_ellipses', place, now.pose, now.P, colour)


def _landmarks(stamp: int, frame: str, points: Array, P: Array) -> Iterator[Marker]:
    if len(points):
        dots = _drawn(stamp, frame, 'landmarks', 0, Marker.POINTS, np.zeros(3), LANDMARKS)
        dots.scale = Vector3(x=0.3, y=0.3, z=0.0)
        dots.points = _points(points)
        yield dots
    for k, (point, covariance) in enumerate(zip(points, P)):
        yield _ellipse(stamp, frame, 'landmark_ellipses', k, point, covariance, LANDMARKS)


def _points(points: Array) -> list[Point]:
    return [Point(x=x, y=y, z=0.0) for x, y in points[:, :2].tolist()]


def _ellipse(
    stamp: int, frame: str, kind: str, k: int, at: Array, P: Array, colour: str
) -> Marker:
    major, minor, heading = ellipse(P[:2, :2])
    marker = _drawn(
        stamp, frame, kind, k, Marker.CYLINDER, np.array([at[0], at[1], heading]), colour)
    marker.scale = Vector3(
        x=2.0 * ELLIPSE_SIGMAS * major, y=2.0 * ELLIPSE_SIGMAS * minor, z=0.01)
    marker.color.a = 0.4
    return marker


def _drawn(
    stamp: int, frame: str, kind: str, k: int, shape: int, at: Array, colour: str
) -> Marker:
    joined = frame == MAP
    marker = _marker(
        stamp, frame, kind if joined else f'{frame} {kind}', k, Marker.ADD, shape, at)
    red, green, blue = rgb(colour if joined else NOT_JOINED)
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    return marker


def _marker(
    stamp: int, frame: str, namespace: str, k: int, action: int, shape: int, at: Array
) -> Marker:
    return Marker(
        header=header(stamp, frame), ns=namespace, id=k, type=shape, action=action,
        pose=to_pose(at), scale=Vector3(x=1.0, y=1.0, z=1.0),
        color=ColorRGBA(r=0.0, g=0.0, b=0.0, a=1.0), lifetime=Duration(sec=0, nanosec=0),
        frame_locked=False, points=[], colors=[], texture_resource='',
        texture=CompressedImage(
            header=header(stamp, frame), format='', data=np.empty(0, np.uint8)),
        uv_coordinates=[], text='', mesh_resource='',
        mesh_file=MeshFile(filename='', data=np.empty(0, np.uint8)),
        mesh_use_embedded_materials=False)
