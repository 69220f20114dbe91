# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Static transforms of robots, composed to the poses of their sensors in the base frames."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.messages import decoded_as, incoming, RawMessage
from fej_slam_ros.ros.session.frames import FrameNames
from fej_slam_ros.ros.topic_types import TF_TYPE

#: Maximum number of frames stored per topic; the description of a robot has fewer than 200 links.
MAX_STATIC_FRAMES = 10_000
#: Maximum number of links from a sensor to the base; ends the search in a loop of transforms.
MAX_LINKS = 100


class SensorMounts:
    """
    Poses of the sensors of a team.

    Parameters
    ----------
    names : base frames of the robots, and topics of their static transforms

    """

    def __init__(self, names: FrameNames) -> None:
        self._names = names
        # Static transforms of each topic, as parent and pose (4, 4) by child frame.
        self._links: dict[str, dict[str, tuple[str, Array]]] = {}

    def receive(self, arrived: RawMessage) -> list[RejectionReason]:
        """
        Store the static transforms in a message; return the reasons why others are rejected.

        A newer one of the same child frame replaces the older.

        """
        message = decoded_as(arrived, TF_TYPE)
        if message is None:
            return [RejectionReason.BAD_MESSAGE]
        transforms, rejected = incoming.static_transforms(message)
        links = self._links.setdefault(arrived.topic.lstrip('/'), {})
        for transform in transforms:
            if transform.child in links or len(links) < MAX_STATIC_FRAMES:
                links[transform.child] = transform.parent, transform.pose
        return rejected

    def pose(self, robot: str, frame: str) -> Array | None:
        """Return the transform (4, 4) of a frame to the base frame of a robot, None if unknown."""
        for topic in self._names.static_topics(robot):
            links = self._links.get(topic.lstrip('/'), {})
            pose = _pose(links, frame, partial(self._names.is_base, robot))
            if pose is not None:
                return pose
        return None

    def snapshot(self) -> dict[str, Any]:
        """Return the state for a checkpoint as plain data."""
        return {
            topic: {child: [parent, pose.tolist()] for child, (parent, pose) in links.items()}
            for topic, links in self._links.items()}

    def restore(self, stored: dict[str, Any]) -> None:
        """Restore the state of a snapshot."""
        self._links = {
            topic: {child: (parent, np.array(pose)) for child, (parent, pose) in links.items()}
            for topic, links in stored.items()}


def _pose(
    links: Mapping[str, tuple[str, Array]], frame: str, is_base: Callable[[str], bool]
) -> Array | None:
    above: dict[str, Array] = {}
    for ancestor, pose in _ancestors(links, frame):
        if ancestor != frame and is_base(ancestor):
            return pose
        above.setdefault(ancestor, pose)
    # The base may be on another branch, such as a base_footprint below base_link.
    for base in filter(is_base, links):
        for ancestor, pose_of_base in _ancestors(links, base):
            if ancestor in above:
                return np.linalg.solve(pose_of_base, above[ancestor]).astype(np.float64)
    return None


def _ancestors(
    links: Mapping[str, tuple[str, Array]], frame: str
) -> Iterator[tuple[str, Array]]:
    """Yield a frame and those above it, each with the pose (4, 4) of the frame in it."""
    pose: Array = np.eye(4)
    yield frame, pose
    for _ in range(MAX_LINKS):
        if frame not in links:
            return
        frame, link = links[frame]
        pose = link @ pose
        yield frame, pose
