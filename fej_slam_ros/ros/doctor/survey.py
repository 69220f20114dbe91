# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the messages of a bag say, kept topic by topic for the checks, refused or not."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID, NS
from fej_slam_ros.ros.messages import deserialize, Message, RawMessage
from fej_slam_ros.ros.messages.cloud import BadCloudError, read_cloud
from fej_slam_ros.ros.messages.common import from_covariance, from_quaternion, from_time
from fej_slam_ros.ros.session.inputs import CLOUD, ODOMETRY, SENT_TOPICS, TRUE_LANDMARKS

FIELDS = ('x', 'y', 'id', 'var_x', 'cov_xy', 'var_y')


@dataclass(slots=True)
class TopicSeries:
    """
    What all messages of a topic have.

    Attributes
    ----------
    stamps, logged : of each message, in the order in which they were recorded [ns]
    frames, child_frames : how often each was named

    """

    stamps: list[int] = field(default_factory=list)
    logged: list[int] = field(default_factory=list)
    frames: Counter[str] = field(default_factory=Counter)
    child_frames: Counter[str] = field(default_factory=Counter)

    def times(self) -> NDArray[np.int64]:
        """Return the stamps in their order, each once."""
        return np.unique(np.array(self.stamps, np.int64))

    def delays(self) -> NDArray[np.int64]:
        """Return by how much each message was recorded after its stamp [ns]."""
        return np.array(self.logged, np.int64) - np.array(self.stamps, np.int64)


@dataclass(slots=True)
class OdometrySeries(TopicSeries):
    """
    Odometry.

    Attributes
    ----------
    poses : x, y, yaw of each message, NaN where the quaternion is none
    variances : of vx, vy and wz in its twist

    """

    poses: list[tuple[float, float, float]] = field(default_factory=list)
    variances: list[list[float]] = field(default_factory=list)

    def increments(self) -> tuple[NDArray[np.int64], Array]:
        """
        Return how the robot has moved.

        Returns
        -------
        stamps : (n, 2) array, begin and end of each increment [ns]
        moved : (n, 2) array, distance [m] and angle [rad] of it

        """
        stamps, first = np.unique(np.array(self.stamps, np.int64), return_index=True)
        poses = np.array(self.poses).reshape(-1, 3)[first]
        told = np.isfinite(poses).all(axis=1)
        stamps, steps = stamps[told], np.diff(poses[told], axis=0)
        turned = np.abs(np.angle(np.exp(1j * steps[:, 2])))
        return (
            np.column_stack([stamps[:-1], stamps[1:]]),
            np.column_stack([np.hypot(steps[:, 0], steps[:, 1]), turned]))


@dataclass(slots=True)
class ObservationSeries(TopicSeries):
    """
    Scans, of landmarks or robots.

    Attributes
    ----------
    ids : of all observations, scan by scan
    ranges, variances : of all observations, in one array a scan: (n,) and (n, 2)
    id_types : numpy's code of the field id, '' where there is none

    """

    ids: list[NDArray[np.int64]] = field(default_factory=list)
    ranges: list[Array] = field(default_factory=list)
    variances: list[Array] = field(default_factory=list)
    id_types: Counter[str] = field(default_factory=Counter)


class Survey:
    """
    All that is kept of a bag.

    Attributes
    ----------
    topics : by name, those of robots only

    """

    def __init__(self) -> None:
        self.topics: dict[str, TopicSeries] = {}

    def add(self, arrived: RawMessage) -> None:
        """Take in a message of a robot; what cannot be read is left to who refuses it."""
        kind = arrived.topic.rpartition('/')[2]
        if SENT_TOPICS.get(kind) != arrived.type_name or arrived.topic == TRUE_LANDMARKS:
            return
        try:
            message = deserialize(arrived.raw, arrived.type_name)
        # A message cut short makes the deserialiser stumble in as many ways as it can end.
        except Exception:  # noqa: BLE001
            return
        made = {ODOMETRY: OdometrySeries, CLOUD: ObservationSeries}[arrived.type_name]
        topic = self.topics.setdefault(arrived.topic, made())
        if message.header.stamp.nanosec >= NS:
            return
        topic.stamps.append(from_time(message.header.stamp))
        topic.logged.append(arrived.received or 0)
        topic.frames[message.header.frame_id.lstrip('/')] += 1
        if isinstance(topic, OdometrySeries):
            _keep_motion(topic, message)
        elif isinstance(topic, ObservationSeries):
            _keep_sight(topic, message)

    def motion(self, robot: str) -> OdometrySeries:
        """Return the odometry of a robot."""
        topic = self.topics.get(f'{robot}/odom')
        return topic if isinstance(topic, OdometrySeries) else OdometrySeries()

    def sight(self, topic: str) -> ObservationSeries:
        """Return the scans of a topic."""
        told = self.topics.get(topic)
        return told if isinstance(told, ObservationSeries) else ObservationSeries()


def _keep_motion(topic: OdometrySeries, message: Message) -> None:
    topic.child_frames[message.child_frame_id.lstrip('/')] += 1
    p, q = message.pose.pose.position, message.pose.pose.orientation
    is_turn = abs(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w - 1.0) < 0.5
    topic.poses.append((p.x, p.y, from_quaternion(q.x, q.y, q.z, q.w) if is_turn else np.nan))
    topic.variances.append(np.diag(from_covariance(message.twist.covariance)).tolist())


def _keep_sight(topic: ObservationSeries, cloud: Message) -> None:
    try:
        columns = read_cloud(cloud, FIELDS)
    except BadCloudError:
        columns = {}
    size = len(columns['x']) if {'x', 'y'} <= columns.keys() else 0
    if not size:
        columns = {}
    else:
        topic.id_types[columns['id'].dtype.kind if 'id' in columns else ''] += 1
    zero = np.zeros(size)
    topic.ids.append(columns.get('id', np.full(size, NO_ID)).astype(np.int64))
    with np.errstate(over='ignore', invalid='ignore'):
        topic.ranges.append(np.hypot(*(
            columns.get(name, zero).astype(float) for name in ('x', 'y'))))
    topic.variances.append(np.column_stack([
        columns.get(name, zero).astype(float) for name in ('var_x', 'var_y')]))
