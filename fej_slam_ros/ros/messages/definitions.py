# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions of the messages of other packages, as of their releases for ROS 2 Jazzy."""

OTHER_PACKAGES = {
    'aruco_opencv_msgs/msg/MarkerPose': 'uint16 marker_id\ngeometry_msgs/Pose pose\n',
    'aruco_opencv_msgs/msg/BoardPose': 'string board_name\ngeometry_msgs/Pose pose\n',
    'aruco_opencv_msgs/msg/ArucoDetection':
        'std_msgs/Header header\naruco_opencv_msgs/MarkerPose[] markers\n'
        'aruco_opencv_msgs/BoardPose[] boards\n',
    'aruco_msgs/msg/Marker':
        'std_msgs/Header header\nuint32 id\ngeometry_msgs/PoseWithCovariance pose\n'
        'float64 confidence\n',
    'aruco_msgs/msg/MarkerArray':
        'std_msgs/Header header\naruco_msgs/Marker[] markers\n',
    'vision_msgs/msg/ObjectHypothesis': 'string class_id\nfloat64 score\n',
    'vision_msgs/msg/ObjectHypothesisWithPose':
        'vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose\n',
    'vision_msgs/msg/BoundingBox3D': 'geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n',
    'vision_msgs/msg/Detection3D':
        'std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n'
        'vision_msgs/BoundingBox3D bbox\nstring id\n',
    'vision_msgs/msg/Detection3DArray':
        'std_msgs/Header header\nvision_msgs/Detection3D[] detections\n',
    'cartographer_ros_msgs/msg/LandmarkEntry':
        'string id\ngeometry_msgs/Pose tracking_from_landmark_transform\n'
        'float64 translation_weight\nfloat64 rotation_weight\n',
    'cartographer_ros_msgs/msg/LandmarkList':
        'std_msgs/Header header\ncartographer_ros_msgs/LandmarkEntry[] landmarks\n',
    'mrpt_msgs/msg/SingleRangeBearingObservation':
        'float64 range\nfloat64 yaw\nfloat64 pitch\nint32 id\n',
    'mrpt_msgs/msg/ObservationRangeBearing':
        'std_msgs/Header header\ngeometry_msgs/Pose sensor_pose_on_robot\n'
        'float64 min_sensor_distance\nfloat64 max_sensor_distance\nfloat64 sensor_std_range\n'
        'float64 sensor_std_yaw\nfloat64 sensor_std_pitch\n'
        'mrpt_msgs/SingleRangeBearingObservation[] sensed_data\n'}
