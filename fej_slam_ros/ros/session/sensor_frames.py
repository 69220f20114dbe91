# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames of robots and their sensors, from messages that a detector or adapter receives."""

from collections import Counter
from collections.abc import Mapping

import numpy as np

from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.session.frames import FrameNames
from fej_slam_ros.ros.session.sensor_mounts import SensorMounts
from fej_slam_ros.ros.topic_types import STATIC_TF, TF_TYPE


class SensorFrames:
    """
    Frames of robots, by name, and poses of sensors in them, from static transforms.

    Parameters
    ----------
    tf_topics : which topics have the static transforms, as the parameter of this name

    Attributes
    ----------
    names : names of the frames, from the odometry
    topics : types of the topics of static transforms, by topic
    rejected : number of static transforms rejected, by reason

    """

    def __init__(self, robots: Mapping[str, RobotSettings], tf_topics: str) -> None:
        self.robots = robots
        self.names = FrameNames(self, NodeSettings(tf_topics=tf_topics))
        self._mounts = SensorMounts(self.names)
        self.topics = {
            topic.lstrip('/'): TF_TYPE
            for name in robots for topic in self.names.static_topics(name)}
        self.rejected: Counter[str] = Counter()

    def receive(self, arrived: RawMessage) -> bool:
        """Add the static transforms of a message; return whether it is one of them."""
        if arrived.topic.rpartition('/')[2] != STATIC_TF:
            return False
        self.rejected.update(reason.value for reason in self._mounts.receive(arrived))
        return True

    def knows_base(self, robot: str) -> bool:
        """Return whether a parameter or odometry has named the base frame of a robot."""
        return bool(self.robots[robot].base_frame) or self.names.knows_base(robot)

    def is_fixed(self, robot: str, frame: str) -> bool:
        """Return whether a frame is a map or that of the odometry of a robot, hence no sensor."""
        return frame in {MAP, own_frame(robot), self.names.odometry(robot)}

    def pose(self, robot: str, frame: str) -> Array | None:
        """Return the transform (4, 4) of a frame to the base frame of a robot, None if unknown."""
        return np.eye(4) if self.names.is_base(robot, frame) else self._mounts.pose(robot, frame)
