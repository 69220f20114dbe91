# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages of other packages with the poses of objects, such as tags.

A message type is added by a function from the message to `SensedObjects`, and a row in `FORMATS`;
its definition is added to `definitions.OTHER_PACKAGES` if ROS itself does not have it.
"""

from collections.abc import Callable, Iterable, Iterator
import math
from typing import NamedTuple

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    geometry_msgs__msg__Point as Point, geometry_msgs__msg__Pose as Pose,
    geometry_msgs__msg__Quaternion as Quaternion, geometry_msgs__msg__Vector3 as Vector3,
    std_msgs__msg__Header as Header, tf2_msgs__msg__TFMessage as TFMessage,
    visualization_msgs__msg__MarkerArray as MarkerArray)

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.motion_models import polar_moments
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.detection.objects import DetectedObject
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.messages.incoming import (
    checked_covariance, MAX_VARIANCE, MIN_VARIANCE, RejectedError, spatial_pose)
from fej_slam_ros.ros.messages.incoming_clouds import MAX_DISTANCE

#: A pose that has not been set.
ORIGIN, UPRIGHT = Point(x=0.0, y=0.0, z=0.0), Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
UNSET_POSE = Pose(position=ORIGIN, orientation=UPRIGHT)
#: Smallest coordinate, of the three the largest, of an object in the frame of its sensor [m].
MIN_OBJECT_DISTANCE = 0.01
#: Largest standard deviation of a distance or direction [m, rad].
MAX_SIGMA = math.sqrt(MAX_VARIANCE)
#: Weight of a landmark [1/m^2] from which on it is a factor of a cost function, as usual with
#: Cartographer, and not the inverse of a variance.
MIN_COST_WEIGHT = 1e4
#: Maximum length of the name of an object [characters]; thousands of names are stored.
MAX_OBJECT_NAME = 255


class SensedObject(NamedTuple):
    """An object in a message, unchecked."""

    name: str  #: its identity, '' if it has none
    position: Point | Vector3
    orientation: Quaternion
    P: Array | None = None  #: (3, 3) covariance of the position, if known
    fault: RejectionReason | None = None  #: why it cannot be used, if so


class SensedObjects(NamedTuple):
    """Objects that a sensor has seen at one time."""

    header: Header  #: time, and frame of the sensor
    objects: list[SensedObject]
    sensor_pose: Pose | None = None  #: of the sensor on its robot, where the message has it


class ObjectFormat(NamedTuple):
    """A message type, and how it is read."""

    type_name: str
    topic: str  #: last part of the name of its topic
    read: Callable[[Message], Iterable[SensedObjects]]
    names: str = '.*'  #: pattern of the names of objects that are used


def apriltag(message: TFMessage) -> Iterator[SensedObjects]:
    """Yield the child frames of each parent; apriltag_ros names those of tags FAMILY:ID."""
    return _by_sensor(
        (child.header, SensedObject(
            child.child_frame_id, child.transform.translation, child.transform.rotation))
        for child in message.transforms)


def aruco(message: Message) -> Iterator[SensedObjects]:
    """Yield the markers and boards of an ArucoDetection."""
    named = [
        *((str(marker.marker_id), marker.pose) for marker in message.markers),
        *((board.board_name, board.pose) for board in message.boards)]
    yield SensedObjects(message.header, [
        SensedObject(name, pose.position, pose.orientation) for name, pose in named])


def aruco_ros(message: Message) -> Iterator[SensedObjects]:
    """Yield the markers of a MarkerArray of aruco_msgs, whose covariances are not filled in."""
    yield SensedObjects(message.header, [
        SensedObject(str(marker.id), marker.pose.pose.position, marker.pose.pose.orientation)
        for marker in message.markers])


def detection3d(message: Message) -> Iterator[SensedObjects]:
    """Yield the detections of a Detection3DArray, recognised by their class."""
    return _detections(
        message, lambda detection, best: None if best is None else best.hypothesis.class_id)


def detection3d_track(message: Message) -> Iterator[SensedObjects]:
    """Yield the detections of a Detection3DArray, recognised by their track."""
    return _detections(message, lambda detection, best: detection.id)


def detection3d_anonymous(message: Message) -> Iterator[SensedObjects]:
    """Yield the detections of a Detection3DArray, recognised by nothing."""
    return _detections(message, lambda detection, best: '')


def landmark_list(message: Message) -> Iterator[SensedObjects]:
    """
    Yield the landmarks of a LandmarkList.

    The weight of a translation is the inverse of its variance here. Cartographer multiplies errors
    by it, and its usual weights of 1e4 to 1e5 say nothing about the sensor: they are not used.

    """
    yield SensedObjects(message.header, [_landmark(entry) for entry in message.landmarks])


def range_bearing(message: Message) -> Iterator[SensedObjects]:
    """Yield the points of an ObservationRangeBearing; its pitch is positive downwards."""
    sigma = message.sensor_std_range, message.sensor_std_yaw, message.sensor_std_pitch
    pose = message.sensor_pose_on_robot
    yield SensedObjects(
        message.header, [_polar(observed, sigma) for observed in message.sensed_data],
        None if pose == UNSET_POSE else pose)


def marker_array(message: MarkerArray) -> Iterator[SensedObjects]:
    """Yield the added markers of each sensor and time, recognised by namespace and ID."""
    return _by_sensor(
        (marker.header, SensedObject(
            f'{marker.ns}:{marker.id}' if marker.ns else str(marker.id), marker.pose.position,
            marker.pose.orientation))
        for marker in message.markers if marker.action == marker.ADD)


FORMATS = {
    'apriltag': ObjectFormat(
        'tf2_msgs/msg/TFMessage', 'tf', apriltag, '[A-Za-z]*[0-9]+h[0-9]+:[0-9]+'),
    'aruco': ObjectFormat('aruco_opencv_msgs/msg/ArucoDetection', 'aruco_detections', aruco),
    'aruco_ros': ObjectFormat('aruco_msgs/msg/MarkerArray', 'markers', aruco_ros),
    'detection3d': ObjectFormat('vision_msgs/msg/Detection3DArray', 'detections', detection3d),
    'detection3d_track': ObjectFormat(
        'vision_msgs/msg/Detection3DArray', 'detections', detection3d_track),
    'detection3d_anonymous': ObjectFormat(
        'vision_msgs/msg/Detection3DArray', 'detections', detection3d_anonymous),
    'landmark_list': ObjectFormat(
        'cartographer_ros_msgs/msg/LandmarkList', 'landmark', landmark_list),
    'range_bearing': ObjectFormat(
        'mrpt_msgs/msg/ObservationRangeBearing', 'range_bearing', range_bearing),
    'marker_array': ObjectFormat('visualization_msgs/msg/MarkerArray', 'tags', marker_array)}


def detected(sensed: SensedObject) -> DetectedObject | RejectionReason:
    """Return an object of a message, or the reason why it is rejected."""
    if sensed.fault is not None:
        return sensed.fault
    if len(sensed.name) > MAX_OBJECT_NAME:
        return RejectionReason.BAD_ID
    try:
        pose = spatial_pose(sensed.position, sensed.orientation)
        P = None if sensed.P is None else checked_covariance(sensed.P)
    except RejectedError as rejected:
        return rejected.reason
    distance = np.abs(pose[:3, 3]).max()
    # A position of zero is one that has not been set.
    return (
        DetectedObject(sensed.name, pose, P) if MIN_OBJECT_DISTANCE < distance < MAX_DISTANCE
        else RejectionReason.OUT_OF_RANGE)


def _by_sensor(objects: Iterable[tuple[Header, SensedObject]]) -> Iterator[SensedObjects]:
    """Yield objects together that one sensor has seen at one time."""
    found: dict[tuple[str, int, int], SensedObjects] = {}
    for header, sensed in objects:
        key = header.frame_id, header.stamp.sec, header.stamp.nanosec
        found.setdefault(key, SensedObjects(header, [])).objects.append(sensed)
    yield from found.values()


def _detections(
    message: Message, name: Callable[[Message, Message | None], str | None]
) -> Iterator[SensedObjects]:
    """
    Yield the detections of each frame with their most likely hypotheses.

    The name is that of a detection and its hypothesis, which may be missing; None if it has none.

    """
    if not message.detections:
        yield SensedObjects(message.header, [])
    yield from _by_sensor(
        (Header(
            stamp=message.header.stamp,
            frame_id=detection.header.frame_id or message.header.frame_id),
         _detection(detection, name))
        for detection in message.detections)


def _detection(
    detection: Message, name: Callable[[Message, Message | None], str | None]
) -> SensedObject:
    best = max(detection.results, key=lambda result: result.hypothesis.score, default=None)
    identity = name(detection, best)
    if identity is None:
        return SensedObject('', ORIGIN, UPRIGHT, fault=RejectionReason.NO_IDENTITY)
    # Detectors that give a box only have no hypothesis, or leave its pose as it is by default.
    pose = detection.bbox.center
    P = np.zeros((3, 3))
    if best is not None:
        P = np.reshape(best.pose.covariance, (6, 6))[:3, :3]
        pose = pose if best.pose.pose == UNSET_POSE else best.pose.pose
    is_known = any(np.ravel(P).tolist())
    return SensedObject(identity, pose.position, pose.orientation, P if is_known else None)


def _landmark(entry: Message) -> SensedObject:
    pose, weight = entry.tracking_from_landmark_transform, entry.translation_weight
    fault = (
        RejectionReason.BAD_COVARIANCE if not 0.0 < weight < math.inf else
        RejectionReason.OUT_OF_RANGE
        if not 1.0 / MAX_VARIANCE <= weight <= 1.0 / MIN_VARIANCE else None)
    P = None if fault is not None or weight >= MIN_COST_WEIGHT else np.eye(3) / weight
    return SensedObject(entry.id, pose.position, pose.orientation, P, fault)


def _polar(observed: Message, sigma: tuple[float, float, float]) -> SensedObject:
    """Return a point as an object that faces the sensor."""
    distance, yaw, pitch = polar = observed.range, observed.yaw, observed.pitch
    fault = (
        RejectionReason.NOT_FINITE if not all(map(math.isfinite, (*polar, *sigma))) else
        RejectionReason.OUT_OF_RANGE if not 0.0 < distance < MAX_DISTANCE
        or max(map(abs, sigma)) > MAX_SIGMA else
        RejectionReason.BAD_ID if observed.id < NO_ID else None)
    name = '' if observed.id == NO_ID else str(observed.id)
    if fault is not None:
        return SensedObject(name, ORIGIN, UPRIGHT, fault=fault)
    x = distance * math.cos(pitch) * math.cos(yaw)
    y = distance * math.cos(pitch) * math.sin(yaw)
    z = -distance * math.sin(pitch)
    mean, P = _spherical_moments(distance, yaw, pitch, sigma)
    bias = mean - np.array([x, y, z])
    # Turned by the yaw about z, after 90 degrees and the pitch about y: z is the line of sight.
    cz, sz = math.cos(yaw / 2.0), math.sin(yaw / 2.0)
    cy, sy = math.cos(math.pi / 4.0 + pitch / 2.0), math.sin(math.pi / 4.0 + pitch / 2.0)
    return SensedObject(
        name, Point(x=x, y=y, z=z), Quaternion(x=-sz * sy, y=cz * sy, z=sz * cy, w=cz * cy),
        P + np.outer(bias, bias) if any(sigma) else None)


def _spherical_moments(
    r: float, yaw: float, pitch: float, sigma: tuple[float, float, float]
) -> tuple[Array, Array]:
    """Return mean (3,) and covariance (3, 3) of a point from range, yaw and pitch [m, rad]."""
    sigma_r, sigma_yaw, sigma_pitch = sigma
    (horizontal, z), C = polar_moments(r, -pitch, sigma_r, sigma_pitch)
    xy, P = polar_moments(horizontal, yaw, math.sqrt(C[0, 0]), sigma_yaw)
    direction, _ = polar_moments(1.0, yaw, 0.0, sigma_yaw)
    P_xy_z = (C[0, 1] * direction)[:, None]
    return np.append(xy, z), np.block([[P, P_xy_z], [P_xy_z.T, C[1, 1]]])
