# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contents of the messages of a bag by topic, whether the estimator accepts them or not."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.geometry import Array, Stamps
from fej_slam_ros.core.records import NO_ID, NS
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.ros.messages import decoded, Message, RawMessage
from fej_slam_ros.ros.messages.cloud import BadCloudError, read_cloud
from fej_slam_ros.ros.messages.common import from_covariance, from_quaternion, from_time
from fej_slam_ros.ros.messages.incoming_clouds import COVARIANCE, POINT
from fej_slam_ros.ros.topic_types import CLOUD, ODOMETRY, SENT_TOPICS, TRUE_LANDMARKS

CLOUD_FIELDS = (*POINT, 'id', *COVARIANCE)


@dataclass(slots=True)
class TopicSeries:
    """Times and frames of the messages of a topic."""

    #: stamps, logged: stamp and log time of each message, in recorded order [ns]
    stamps: list[int] = field(default_factory=list)
    logged: list[int] = field(default_factory=list)
    frames: Counter[str] = field(default_factory=Counter)  #: number of messages by frame

    def times(self) -> Stamps:
        """Return the distinct stamps, ascending [ns]."""
        return np.unique(np.array(self.stamps, np.int64))

    def span(self) -> tuple[int, int]:
        """Return the first and the last stamp [ns]."""
        return min(self.stamps), max(self.stamps)

    def period(self) -> float:
        """Return the median time between stamps [ns]."""
        return float(np.median(np.diff(self.times())))

    def delays(self) -> Stamps:
        """Return log time minus stamp of each message [ns]."""
        return np.array(self.logged, np.int64) - np.array(self.stamps, np.int64)

    def without_future(self, limit: float) -> 'TopicSeries':
        """Return the times of messages stamped at most a limit [ns] ahead of the median one."""
        delays = self.delays()
        if not len(delays):
            return self
        kept = delays >= np.median(delays) - limit
        return TopicSeries(
            np.array(self.stamps)[kept].tolist(), np.array(self.logged)[kept].tolist())


@dataclass(slots=True)
class OdometrySeries(TopicSeries):
    """Messages of an odometry topic."""

    child_frames: Counter[str] = field(default_factory=Counter)  #: number of messages likewise
    #: x, y, yaw of each message, NaN where the quaternion is invalid
    poses: list[tuple[float, float, float]] = field(default_factory=list)
    covariances: list[Array] = field(default_factory=list)  #: (3, 3) of vx, vy, wz in each twist

    def increments(self) -> tuple[Stamps, Array]:
        """
        Return the motion between consecutive stamps, two (n, 2) arrays.

        They hold begin and end of each increment [ns], its distance [m] and absolute angle [rad].
        """
        stamps, poses = self.ordered()
        steps = np.diff(poses, axis=0)
        turned = np.abs(np.angle(np.exp(1j * steps[:, 2])))
        return (
            np.column_stack([stamps[:-1], stamps[1:]]),
            np.column_stack([np.hypot(steps[:, 0], steps[:, 1]), turned]))

    def positions(self) -> tuple[Stamps, Array]:
        """Return stamps and positions as recorded, (n,) [ns] and (n, 2)."""
        return np.array(self.stamps, np.int64), np.array(self.poses).reshape(-1, 3)[:, :2]

    def ordered(self) -> tuple[Stamps, Array]:
        """Return the stamps (n,) [ns] of the valid poses in order, each once, and these (n, 3)."""
        stamps, first = np.unique(np.array(self.stamps, np.int64), return_index=True)
        poses = np.array(self.poses).reshape(-1, 3)[first]
        finite = np.isfinite(poses).all(axis=1)
        return stamps[finite], poses[finite]

    def add(self, message: Message) -> None:
        self.child_frames[message.child_frame_id.lstrip('/')] += 1
        p, q = message.pose.pose.position, message.pose.pose.orientation
        is_valid = abs(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w - 1.0) < 0.5
        self.poses.append((p.x, p.y, from_quaternion(q.x, q.y, q.z, q.w) if is_valid else np.nan))
        self.covariances.append(from_covariance(message.twist.covariance))


@dataclass(slots=True)
class ObservationSeries(TopicSeries):
    """Scans of a topic of landmark or robot observations."""

    #: ids, ranges, variances: of the observations of each scan, (n,), (n,) and (n, 2) arrays
    ids: list[NDArray[np.int64]] = field(default_factory=list)
    ranges: list[Array] = field(default_factory=list)
    variances: list[Array] = field(default_factory=list)
    id_counts: Counter[int] = field(default_factory=Counter)  #: number of observations by ID
    #: number of scans by numpy's kind of the field id, '' without that field
    id_types: Counter[str] = field(default_factory=Counter)

    def add(self, message: Message) -> None:
        try:
            columns = read_cloud(message, CLOUD_FIELDS)
        except BadCloudError:
            columns = {}
        size = len(columns['x']) if {'x', 'y'} <= columns.keys() else 0
        if size:
            self.id_types[columns['id'].dtype.kind if 'id' in columns else ''] += 1
        else:
            columns = {}
        zero = np.zeros(size)
        if not columns.keys() >= {*COVARIANCE}:
            columns['var_x'] = columns['var_y'] = zero
        x, y, var_x, var_y = (
            columns.get(name, zero).astype(float) for name in ('x', 'y', 'var_x', 'var_y'))
        with np.errstate(over='ignore', invalid='ignore'):
            self.ids.append(columns.get('id', np.full(size, NO_ID)).astype(np.int64))
            self.ranges.append(np.hypot(x, y))
        self.id_counts.update(self.ids[-1].tolist())
        self.variances.append(np.column_stack([var_x, var_y]))

    def positions(self) -> tuple[Stamps, Array]:
        """Return stamps (n,) [ns] and ranges (n, 1) of the ID that is observed most often."""
        (id_, _), *_ = self.id_counts.most_common(1) or [(NO_ID, 0)]
        rows = [
            (stamp, r) for stamp, ids, ranges in zip(self.stamps, self.ids, self.ranges)
            for r in ranges[ids == id_]]
        stamps = np.array([stamp for stamp, _ in rows], np.int64)
        return stamps, np.array([r for _, r in rows]).reshape(-1, 1)


class Survey:
    """Contents of a bag."""

    def __init__(self) -> None:
        self.topics: dict[str, OdometrySeries | ObservationSeries] = {}  #: of each robot, by name

    def add(self, raw: RawMessage) -> None:
        """Add a message of a robot; the trial run reports those that cannot be read."""
        kind = raw.topic.rpartition('/')[2]
        if SENT_TOPICS.get(kind) != raw.type_name or raw.topic == TRUE_LANDMARKS:
            return
        message = decoded(raw.raw, raw.type_name)
        if message is None:
            return
        series = {ODOMETRY: OdometrySeries, CLOUD: ObservationSeries}[raw.type_name]()
        topic = self.topics.setdefault(raw.topic, series)
        if message.header.stamp.nanosec >= NS:
            return
        topic.stamps.append(from_time(message.header.stamp))
        topic.logged.append(raw.received or 0)
        topic.frames[message.header.frame_id.lstrip('/')] += 1
        topic.add(message)

    def odometry(self, robot: str) -> OdometrySeries:
        """Return the odometry of a robot, empty if there is none."""
        topic = self.topics.get(f'{robot}/odom')
        return topic if isinstance(topic, OdometrySeries) else OdometrySeries()

    def moving(self, settings: CommonSettings) -> dict[str, TopicSeries]:
        """Return the times of odometry that has two stamps or more, without future stamps."""
        odometry = {
            robot.name: self.odometry(robot.name).without_future(settings.future_limit * NS)
            for robot in settings.robots}
        return {name: topic for name, topic in odometry.items() if len(topic.times()) > 1}

    def observations(self, topic: str) -> ObservationSeries:
        """Return the scans of a topic, empty if there are none."""
        series = self.topics.get(topic)
        return series if isinstance(series, ObservationSeries) else ObservationSeries()
