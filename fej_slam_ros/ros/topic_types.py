# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that nodes read and publish: their names, and the types of their messages."""

from collections.abc import Iterable, Mapping

ODOMETRY = 'nav_msgs/msg/Odometry'
CLOUD = 'sensor_msgs/msg/PointCloud2'
LASER_SCAN = 'sensor_msgs/msg/LaserScan'
TF_TYPE = 'tf2_msgs/msg/TFMessage'
POSE_WITH_COVARIANCE = 'geometry_msgs/msg/PoseWithCovarianceStamped'

#: Types of the topics that a robot publishes, by the last part of their names.
SENT_TOPICS = {'odom': ODOMETRY, 'landmarks': CLOUD, 'robots': CLOUD, 'ground_truth': ODOMETRY}
#: Those of observations, and of all measurements.
OBSERVATION_TOPICS = ('landmarks', 'robots')
MEASUREMENT_TOPICS = ('odom', *OBSERVATION_TOPICS)
#: Types of all topics of a robot: users publish ``set_pose``, which a smoother with peers ignores.
ROBOT_TOPICS = SENT_TOPICS | {'set_pose': POSE_WITH_COVARIANCE}
TRUE_LANDMARKS = 'ground_truth/landmarks'
#: Topic of RViz for the pose of one robot, the parameter `initialpose_robot`.
INITIALPOSE = 'initialpose'
#: Topic by which smoothers of several robots exchange measurements.
EXCHANGE_TOPIC, EXCHANGE_TYPE = '/exchange', 'std_msgs/msg/UInt8MultiArray'
#: Last part of the names of topics with transforms, and with static ones.
TF, STATIC_TF = 'tf', 'tf_static'

#: Topics of the results of a node; ``~`` stands for its name.
LANDMARKS_TOPIC = '~/landmarks'
MARKERS_TOPIC = '~/markers'
JOINT_COVARIANCE_TOPIC = '~/joint_covariance'
REJECTIONS_TOPIC = '~/rejections'
DIAGNOSTICS_TOPIC = '/diagnostics'
#: Topic of the IDs of landmarks by the names of the detected objects.
LANDMARK_IDS = 'landmark_ids'

#: Types of the results of an estimator, and of those on topics of each robot.
OUTPUT_TYPES = {
    LANDMARKS_TOPIC: CLOUD,
    MARKERS_TOPIC: 'visualization_msgs/msg/MarkerArray',
    JOINT_COVARIANCE_TOPIC: 'std_msgs/msg/Float64MultiArray',
    REJECTIONS_TOPIC: 'diagnostic_msgs/msg/DiagnosticStatus',
    DIAGNOSTICS_TOPIC: 'diagnostic_msgs/msg/DiagnosticArray',
}
ROBOT_OUTPUT_TYPES = {
    'pose': POSE_WITH_COVARIANCE,
    'path': 'nav_msgs/msg/Path',
    'map_landmarks': CLOUD,
}
#: Types of the predicted poses of each robot by a live estimator.
PREDICTED_TYPES = {'predicted_pose': POSE_WITH_COVARIANCE, 'odometry/filtered': ODOMETRY}
#: Types of the results of a smoother, and of those on topics of each robot.
SMOOTHED_TEAM_TYPES = {
    topic: OUTPUT_TYPES[topic]
    for topic in (LANDMARKS_TOPIC, MARKERS_TOPIC, REJECTIONS_TOPIC, DIAGNOSTICS_TOPIC)}
SMOOTHED_ROBOT_TYPES = ROBOT_OUTPUT_TYPES | {'base_node': POSE_WITH_COVARIANCE}


def expected_topics(
    robots: Iterable[str], robot_topics: Mapping[str, str] = ROBOT_TOPICS
) -> dict[str, str]:
    """Return the types of the input topics of a team, by topic."""
    of_team = {TRUE_LANDMARKS: CLOUD}
    if 'set_pose' in robot_topics:
        of_team[INITIALPOSE] = POSE_WITH_COVARIANCE
    return {
        f'{name}/{kind}': type_name
        for name in robots for kind, type_name in robot_topics.items()} | of_team


def relative_topic(observer: str, observed: str) -> str:
    """Return the topic of the pose of one robot in the base frame of another."""
    return f'{observer}/relative_pose/{observed}'


def transform_topics(tf_topics: str, robot: str, kind: str) -> list[str]:
    """
    Return the topics with transforms of a robot, its own first.

    Parameters
    ----------
    tf_topics : value of the parameter of this name
    kind : last part of the names, `TF` or `STATIC_TF`

    """
    own, shared = f'{robot}/{kind}', f'/{kind}'
    return {'robot': [own], 'shared': [shared], 'both': [own, shared]}[tf_topics]
