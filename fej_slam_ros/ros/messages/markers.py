# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Markers for RViz: robots, maps and detected landmarks."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from rosbags.typesys.stores.ros2_jazzy import (
    builtin_interfaces__msg__Duration as Duration, geometry_msgs__msg__Point as Point,
    geometry_msgs__msg__Pose as Pose, geometry_msgs__msg__Quaternion as Quaternion,
    geometry_msgs__msg__Vector3 as Vector3, sensor_msgs__msg__CompressedImage as CompressedImage,
    std_msgs__msg__ColorRGBA as ColorRGBA, std_msgs__msg__Header as Header,
    visualization_msgs__msg__Marker as Marker, visualization_msgs__msg__MarkerArray as MarkerArray,
    visualization_msgs__msg__MeshFile as MeshFile)
from scipy.spatial.transform import Rotation

from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, ellipse
from fej_slam_ros.detection.records import RobotTags
from fej_slam_ros.palette import LANDMARK_COLOUR, NAME_COLOUR, NOT_JOINED_COLOUR, rgb, robot_colour
from fej_slam_ros.ros.messages.common import header, to_pose

#: Radius of the ellipses in markers, standard deviations.
MARKER_SIGMAS = 3.0
#: Size of the markers of tags [m].
TAG_SIZE = (0.16, 0.16, 0.01)
#: Smallest radius of a detected landmark that is drawn [m].
MIN_MARKER_RADIUS = 0.03


def markers(
    stamp: int, robots: Sequence[tuple[int, PoseEstimate, Array]],
    maps: Sequence[tuple[str, Array, Array]], map_frame: str,
) -> MarkerArray:
    """
    Return robots with names and paths, landmarks, and the 3-sigma ellipses of both.

    Markers of other frames than ``map`` are grey, with the frame in their namespaces, so that they
    can be hidden.

    Parameters
    ----------
    robots : index, newest pose and path (n, 3) of each
    maps : frame, landmarks (n, 2) and their covariances (n, 2, 2) of each
    map_frame : name of the frame ``map`` in the message

    """
    drawn = [_delete_all(stamp, MAP)]
    for index, newest, poses in robots:
        drawn += _robot(stamp, index, newest, poses)
    for frame, points, P in maps:
        drawn += _landmarks(stamp, frame, points, P)
    for marker in drawn:
        if marker.header.frame_id == MAP:
            marker.header.frame_id = map_frame
    # The type store annotates the same class of an older release.
    return MarkerArray(markers=drawn)  # type: ignore[arg-type]


def detection_markers(
    stamp: int, frame: str, points: Array, R: Array, radii: Array, names: Sequence[str] = ()
) -> MarkerArray:
    """Return detected landmarks as discs of their radii, with 3-sigma ellipses and names."""
    pen = _Pen(stamp, frame, LANDMARK_COLOUR)
    drawn = [_delete_all(stamp, frame)]
    for k, (point, covariance, radius) in enumerate(zip(points, R, radii.tolist())):
        width = 2.0 * max(radius, MIN_MARKER_RADIUS)
        drawn.append(pen.draw(
            'detections', k, Marker.CYLINDER, np.append(point, 0.0), width, width, 0.5))
        drawn.append(pen.draw_ellipse('detection_ellipses', k, point, covariance))
    for k, (point, name) in enumerate(zip(points, names)):
        text = pen._replace(colour=NAME_COLOUR).draw(
            'detection_names', k, Marker.TEXT_VIEW_FACING, np.append(point, 0.0), 1.0, 1.0, 0.3)
        text.text, text.pose.position.z = name, 0.3
        drawn.append(text)
    return MarkerArray(markers=drawn)  # type: ignore[arg-type]


def tag_markers(record: RobotTags) -> MarkerArray:
    """Return the tags in an image of a camera as cubes with their numbers as IDs."""
    camera_header, drawn = header(record.stamp, f'{record.robot}/camera_optical_frame'), []
    for tag in record.tags:
        marker = _marker(
            camera_header, 'tags', int(tag.name), Marker.ADD, Marker.CUBE, np.zeros(3), *TAG_SIZE)
        x, y, z = tag.pose[:3, 3].tolist()
        qx, qy, qz, qw = Rotation.from_matrix(tag.pose[:3, :3]).as_quat().tolist()
        marker.pose = Pose(
            position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
        drawn.append(marker)
    return MarkerArray(markers=drawn)  # type: ignore[arg-type]


class _Pen(NamedTuple):
    """Stamp, frame and colour of markers, which are grey in other frames than ``map``."""

    stamp: int
    frame: str
    colour: str

    def draw(self, kind: str, k: int, shape: int, at: Array, *scale: float) -> Marker:
        joined = self.frame == MAP
        marker = _marker(
            header(self.stamp, self.frame), kind if joined else f'{self.frame} {kind}', k,
            Marker.ADD, shape, at, *scale)
        red, green, blue = rgb(self.colour if joined else NOT_JOINED_COLOUR)
        marker.color = ColorRGBA(r=red, g=green, b=blue, a=1.0)
        return marker

    def draw_ellipse(self, kind: str, k: int, at: Array, P: Array) -> Marker:
        major, minor, heading = ellipse(P[:2, :2])
        marker = self.draw(
            kind, k, Marker.CYLINDER, np.array([at[0], at[1], heading]),
            2.0 * MARKER_SIGMAS * major, 2.0 * MARKER_SIGMAS * minor, 0.01)
        marker.color.a = 0.4
        return marker


def _robot(stamp: int, index: int, newest: PoseEstimate, poses: Array) -> Iterator[Marker]:
    pen = _Pen(stamp, newest.frame, robot_colour(index))
    yield pen.draw('robots', index, Marker.ARROW, newest.pose, 1.0, 0.25, 0.25)
    name = pen._replace(colour=NAME_COLOUR).draw(
        'names', index, Marker.TEXT_VIEW_FACING, newest.pose, 1.0, 1.0, 1.5)
    name.text = newest.robot
    name.pose.position.z = 1.5
    name.pose.position.y += 1.5
    yield name
    if len(poses) > 1:  # RViz rejects a line of a single point
        path = pen.draw('paths', index, Marker.LINE_STRIP, np.zeros(3), 0.1, 0.0, 0.0)
        path.points = _points(poses)
        yield path
    yield pen.draw_ellipse('robot_ellipses', index, newest.pose, newest.P)


def _landmarks(stamp: int, frame: str, points: Array, P: Array) -> Iterator[Marker]:
    pen = _Pen(stamp, frame, LANDMARK_COLOUR)
    if len(points):
        dots = pen.draw('landmarks', 0, Marker.POINTS, np.zeros(3), 0.3, 0.3, 0.0)
        dots.points = _points(points)
        yield dots
    for k, (point, covariance) in enumerate(zip(points, P)):
        yield pen.draw_ellipse('landmark_ellipses', k, point, covariance)


def _delete_all(stamp: int, frame: str) -> Marker:
    """Return a marker that deletes the earlier ones."""
    return _marker(header(stamp, frame), 'all', 0, Marker.DELETEALL, Marker.ARROW, np.zeros(3))


def _points(points: Array) -> list[Point]:
    return [Point(x=x, y=y, z=0.0) for x, y in points[:, :2].tolist()]


def _marker(
    marker_header: Header, namespace: str, k: int, action: int, shape: int, at: Array,
    *scale: float
) -> Marker:
    x, y, z = scale or (1.0, 1.0, 1.0)
    return Marker(
        header=marker_header, ns=namespace, id=k, type=shape, action=action,
        pose=to_pose(at), scale=Vector3(x=x, y=y, z=z),
        color=ColorRGBA(r=0.0, g=0.0, b=0.0, a=1.0), lifetime=Duration(sec=0, nanosec=0),
        frame_locked=False, points=[], colors=[], texture_resource='',
        texture=CompressedImage(header=marker_header, format='', data=np.empty(0, np.uint8)),
        uv_coordinates=[], text='', mesh_resource='',
        mesh_file=MeshFile(filename='', data=np.empty(0, np.uint8)),
        mesh_use_embedded_materials=False)
