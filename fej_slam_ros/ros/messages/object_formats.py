# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages of other packages with the poses of objects, such as tags.

A message type is added by a function from the message to `SensedObjects`, and a row in `FORMATS`;
its definition is added to `definitions.OTHER_PACKAGES` if ROS itself does not have it.
"""

from collections import defaultdict
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
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.detection.objects import DetectedObject
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.messages.incoming import (
    checked_covariance, MAX_DISTANCE, RejectedError, spatial_pose)

#: Orientation of what has none.
UPRIGHT = Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)


class SensedObject(NamedTuple):
    """An object in a message, unchecked."""

    name: str  #: what it is recognised by, '' if by nothing
    position: Point | Vector3
    orientation: Quaternion
    P: Array | None = None  #: (3, 3) covariance of the position, if known


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
    by_sensor = defaultdict(list)
    for of in message.transforms:
        stamp = of.header.stamp
        by_sensor[of.header.frame_id, stamp.sec, stamp.nanosec].append(of)
    for transforms in by_sensor.values():
        yield SensedObjects(transforms[0].header, [
            SensedObject(of.child_frame_id, of.transform.translation, of.transform.rotation)
            for of in transforms])


def aruco(message: Message) -> Iterator[SensedObjects]:
    """Yield the markers and boards of an ArucoDetection."""
    named = [
        *((str(of.marker_id), of.pose) for of in message.markers),
        *((of.board_name, of.pose) for of in message.boards)]
    yield SensedObjects(
        message.header, [SensedObject(name, p.position, p.orientation) for name, p in named])


def detection3d(message: Message) -> Iterator[SensedObjects]:
    """Yield the detections of a Detection3DArray, recognised by their class."""
    return _detections(message, lambda detection, best: best.hypothesis.class_id)


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
    by it, but with its usual weights of 1e4 to 1e5 that would mean micrometres.

    """
    yield SensedObjects(message.header, [
        SensedObject(
            of.id, pose.position, pose.orientation,
            np.eye(3) / of.translation_weight if of.translation_weight > 0.0 else None)
        for of in message.landmarks for pose in [of.tracking_from_landmark_transform]])


def range_bearing(message: Message) -> Iterator[SensedObjects]:
    """Yield the points of an ObservationRangeBearing; its pitch is positive downwards."""
    sigma = message.sensor_std_range, message.sensor_std_yaw, message.sensor_std_pitch
    pose = message.sensor_pose_on_robot
    yield SensedObjects(
        message.header, [
            SensedObject(
                '' if of.id == NO_ID else str(of.id),
                _polar_point(of.range, of.yaw, of.pitch), UPRIGHT,
                _polar_covariance(of.range, of.yaw, of.pitch, sigma))
            for of in message.sensed_data],
        None if pose == Pose(position=Point(x=0.0, y=0.0, z=0.0), orientation=UPRIGHT) else pose)


def marker_array(message: MarkerArray) -> Iterator[SensedObjects]:
    """Yield the added markers of each sensor and time, recognised by namespace and ID."""
    by_sensor = defaultdict(list)
    for of in message.markers:
        if of.action == of.ADD:
            stamp = of.header.stamp
            by_sensor[of.header.frame_id, stamp.sec, stamp.nanosec].append(of)
    for markers in by_sensor.values():
        yield SensedObjects(markers[0].header, [
            SensedObject(
                f'{of.ns}:{of.id}' if of.ns else str(of.id), of.pose.position, of.pose.orientation)
            for of in markers])


FORMATS = {
    'apriltag': ObjectFormat(
        'tf2_msgs/msg/TFMessage', 'tf', apriltag, '[A-Za-z]*[0-9]+h[0-9]+:[0-9]+'),
    'aruco': ObjectFormat('aruco_opencv_msgs/msg/ArucoDetection', 'aruco_detections', aruco),
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
    try:
        pose = spatial_pose(sensed.position, sensed.orientation)
        P = None if sensed.P is None else checked_covariance(sensed.P)
    except RejectedError as rejected:
        return rejected.reason
    if np.abs(pose[:3, 3]).max() > MAX_DISTANCE:
        return RejectionReason.OUT_OF_RANGE
    return DetectedObject(sensed.name, pose, P)


def _detections(
    message: Message, name: Callable[[Message, Message], str]
) -> Iterator[SensedObjects]:
    """Yield the detections of each frame with their most likely hypotheses."""
    by_sensor: defaultdict[str, list[SensedObject]] = defaultdict(list)
    for of in message.detections:
        best = max(of.results, key=lambda result: result.hypothesis.score, default=None)
        if best is not None:
            P = np.reshape(best.pose.covariance, (6, 6))[:3, :3]
            by_sensor[of.header.frame_id or message.header.frame_id].append(SensedObject(
                name(of, best), best.pose.pose.position, best.pose.pose.orientation,
                P if P.any() else None))
    if not by_sensor:
        yield SensedObjects(message.header, [])
    for frame, objects in by_sensor.items():
        yield SensedObjects(Header(stamp=message.header.stamp, frame_id=frame), objects)


def _polar_point(distance: float, yaw: float, pitch: float) -> Point:
    level = distance * math.cos(pitch)
    return Point(
        x=level * math.cos(yaw), y=level * math.sin(yaw), z=-distance * math.sin(pitch))


def _polar_covariance(
    distance: float, yaw: float, pitch: float, sigma: tuple[float, float, float]
) -> Array | None:
    """Return the covariance (3, 3) of a point by those of distance, yaw and pitch, if known."""
    if not any(sigma):
        return None
    c, s, C, S = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    J = np.array([
        [c * C, -distance * s * C, -distance * c * S],
        [s * C, distance * c * C, -distance * s * S],
        [-S, 0.0, -distance * C]])
    covariance: Array = J @ np.diag(np.square(sigma)) @ J.T
    return covariance
