# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Messages of packages that this one does not depend on, made from their own definitions.

The definitions are those that the packages install for ROS 2 Jazzy, without their comments.
"""

import numpy as np
from rosbags.typesys import get_types_from_msg

from helpers.ros import header, raw, TYPES

DEFINITIONS = {
    'aruco_opencv_msgs/msg/MarkerPose': """
uint16 marker_id
geometry_msgs/Pose pose
""",
    'aruco_opencv_msgs/msg/BoardPose': """
string board_name
geometry_msgs/Pose pose
""",
    'aruco_opencv_msgs/msg/ArucoDetection': """
std_msgs/Header header

MarkerPose[] markers
BoardPose[] boards
""",
    'aruco_msgs/msg/Marker': """
std_msgs/Header header
uint32 id
geometry_msgs/PoseWithCovariance pose
float64 confidence
""",
    'aruco_msgs/msg/MarkerArray': """
std_msgs/Header header
aruco_msgs/Marker[] markers
""",
    'vision_msgs/msg/ObjectHypothesis': """
string class_id
float64 score
""",
    'vision_msgs/msg/ObjectHypothesisWithPose': """
ObjectHypothesis hypothesis
geometry_msgs/PoseWithCovariance pose
""",
    'vision_msgs/msg/BoundingBox3D': """
geometry_msgs/Pose center
geometry_msgs/Vector3 size
""",
    'vision_msgs/msg/Detection3D': """
std_msgs/Header header
ObjectHypothesisWithPose[] results
BoundingBox3D bbox
string id
""",
    'vision_msgs/msg/Detection3DArray': """
std_msgs/Header header
vision_msgs/Detection3D[] detections
""",
    'cartographer_ros_msgs/msg/LandmarkEntry': """
string id
geometry_msgs/Pose tracking_from_landmark_transform
float64 translation_weight
float64 rotation_weight
""",
    'cartographer_ros_msgs/msg/LandmarkList': """
std_msgs/Header header
cartographer_ros_msgs/LandmarkEntry[] landmarks
""",
    'mrpt_msgs/msg/SingleRangeBearingObservation': """
float64 range
float64 yaw
float64 pitch
int32 id
""",
    'mrpt_msgs/msg/ObservationRangeBearing': """
std_msgs/Header header
geometry_msgs/Pose sensor_pose_on_robot
float64 min_sensor_distance
float64 max_sensor_distance
float64 sensor_std_range
float64 sensor_std_yaw
float64 sensor_std_pitch
mrpt_msgs/SingleRangeBearingObservation[] sensed_data
"""}

for name, text in DEFINITIONS.items():
    TYPES.register(get_types_from_msg(text, name))


def make(name, **values):
    """Return a message of a type such as geometry_msgs/Pose."""
    package, _, kind = name.partition('/')
    return TYPES.types[f'{package}/msg/{kind}'](**values)


def point(x, y, z):
    return make('geometry_msgs/Point', x=float(x), y=float(y), z=float(z))


def turned(w=1.0, z=0.0):
    return make('geometry_msgs/Quaternion', x=0.0, y=0.0, z=z, w=w)


def pose(position, orientation=None):
    orientation = orientation or turned()
    return make('geometry_msgs/Pose', position=point(*position), orientation=orientation)


def april_tags(ms, frame, tags, topic='r1/tf'):
    """Return what apriltag_ros publishes: transforms to child frames FAMILY:ID."""
    return raw(topic, make('tf2_msgs/TFMessage', transforms=[
        make(
            'geometry_msgs/TransformStamped', header=header(ms, frame), child_frame_id=name,
            transform=make(
                'geometry_msgs/Transform',
                translation=make('geometry_msgs/Vector3', x=x, y=y, z=z), rotation=turned()))
        for name, (x, y, z) in tags.items()]), ms)


def aruco(ms, frame, markers, boards=()):
    return raw('r1/aruco_detections', make(
        'aruco_opencv_msgs/ArucoDetection', header=header(ms, frame),
        markers=[make('aruco_opencv_msgs/MarkerPose', marker_id=id_, pose=pose(at))
                 for id_, at in markers.items()],
        boards=[make('aruco_opencv_msgs/BoardPose', board_name=name, pose=pose(at))
                for name, at in dict(boards).items()]), ms)


def aruco_ros(ms, frame, markers):
    return raw('r1/markers', make(
        'aruco_msgs/MarkerArray', header=header(ms, frame), markers=[
            make(
                'aruco_msgs/Marker', header=header(ms, frame), id=id_, confidence=1.0,
                pose=make(
                    'geometry_msgs/PoseWithCovariance', pose=pose(at), covariance=np.zeros(36)))
            for id_, at in markers.items()]), ms)


def detections3d(ms, frame, detections, box=(0, 0, 0), frame_of_each=''):
    """
    Return detections of (class, track, position, covariance (6, 6) or None).

    One that is None has no hypothesis.
    """
    return raw('r1/detections', make(
        'vision_msgs/Detection3DArray', header=header(ms, frame),
        detections=[
            _detection(header(ms, frame_of_each), detection, box)
            for detection in detections]), ms)


def _detection(of_detection, detection, box):
    results = [] if detection is None else [
        _hypothesis('another', 0.1, (0, 0, 0), None),
        _hypothesis(detection[0], 0.9, *detection[2:])]
    return make(
        'vision_msgs/Detection3D', header=of_detection,
        id='' if detection is None else detection[1],
        bbox=make(
            'vision_msgs/BoundingBox3D', center=pose(box),
            size=make('geometry_msgs/Vector3', x=0.0, y=0.0, z=0.0)),
        results=results)


def _hypothesis(class_id, score, at, covariance):
    full = np.zeros((6, 6)) if covariance is None else covariance
    return make(
        'vision_msgs/ObjectHypothesisWithPose',
        hypothesis=make('vision_msgs/ObjectHypothesis', class_id=class_id, score=score),
        pose=make('geometry_msgs/PoseWithCovariance', pose=pose(at), covariance=full.ravel()))


def landmark_list(ms, frame, landmarks):
    """Return landmarks {name: (position, weight)}."""
    return raw('r1/landmark', make(
        'cartographer_ros_msgs/LandmarkList', header=header(ms, frame), landmarks=[
            make(
                'cartographer_ros_msgs/LandmarkEntry', id=name,
                tracking_from_landmark_transform=pose(at), translation_weight=weight,
                rotation_weight=1.0)
            for name, (at, weight) in landmarks.items()]), ms)


def range_bearing(ms, frame, observations, sigmas=(0.0, 0.0, 0.0), sensor=None):
    """Return observations of (id, range, yaw, pitch)."""
    return raw('r1/range_bearing', make(
        'mrpt_msgs/ObservationRangeBearing', header=header(ms, frame),
        sensor_pose_on_robot=sensor or pose((0, 0, 0)), min_sensor_distance=0.0,
        max_sensor_distance=10.0, sensor_std_range=sigmas[0], sensor_std_yaw=sigmas[1],
        sensor_std_pitch=sigmas[2], sensed_data=[
            make(
                'mrpt_msgs/SingleRangeBearingObservation', id=id_, range=r, yaw=yaw, pitch=pitch)
            for id_, r, yaw, pitch in observations]), ms)


def joined(*messages):
    """Return transforms of several messages in one."""
    name = messages[0].type_name
    return raw(messages[0].topic, TYPES.types[name](transforms=[
        transform for message in messages
        for transform in TYPES.deserialize_cdr(message.raw, name).transforms]), 0)


def marker_array(ms, frame, markers, deleted=()):
    """Return markers {(namespace, id): position}, of which some IDs are deleted."""
    empty = make('visualization_msgs/MeshFile', filename='', data=np.empty(0, np.uint8))
    colour = make('std_msgs/ColorRGBA', r=0.0, g=0.0, b=0.0, a=1.0)
    still = make('builtin_interfaces/Duration', sec=0, nanosec=0)
    image = make(
        'sensor_msgs/CompressedImage', header=header(0, ''), format='',
        data=np.empty(0, np.uint8))
    return raw('r1/tags', make('visualization_msgs/MarkerArray', markers=[
        make(
            'visualization_msgs/Marker', header=header(ms, frame), ns=ns, id=id_, type=1,
            action=2 if id_ in deleted else 0, pose=pose(at), color=colour,
            scale=make('geometry_msgs/Vector3', x=0.1, y=0.1, z=0.1), lifetime=still,
            frame_locked=False, points=[], colors=[], texture_resource='', texture=image,
            uv_coordinates=[], text='', mesh_resource='', mesh_file=empty,
            mesh_use_embedded_materials=False)
        for (ns, id_), at in markers.items()]), ms)
