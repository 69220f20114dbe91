# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""From serialised messages to estimator or smoother, the same way for live topics and bags."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.ordering.time_jump import Consumer, TimeJumpDetector
from fej_slam_ros.core.records import AnyScan, NS
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.ros.messages import deserialize, incoming, Message, RawMessage, serialize
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.session.clock_offsets import Clocks

ODOMETRY = 'nav_msgs/msg/Odometry'
CLOUD = 'sensor_msgs/msg/PointCloud2'
GIVEN_POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'

#: Inputs of each robot by the last part of their topics: what it sends, and what it is told.
SENT_TOPICS = {'odom': ODOMETRY, 'landmarks': CLOUD, 'robots': CLOUD, 'ground_truth': ODOMETRY}
ROBOT_TOPICS = SENT_TOPICS | {'set_pose': GIVEN_POSE}
TRUE_LANDMARKS = 'ground_truth/landmarks'

#: So many scans wait for the odometry that tells whether their frame is right.
MAX_HELD = 1000
#: So many child frames of a robot's odometry are known at most.
MAX_FRAMES = 10


class Inputs:
    """
    The edge of an estimator or a smoother.

    Parameters
    ----------
    consumer : what gets the records and counts what is refused
    robot_topics : the inputs of each robot that it uses, as in `ROBOT_TOPICS`
    resets_on_time_jump : whether another run follows a time jump

    Attributes
    ----------
    unused : how many messages came on topics that are no inputs
    delays : of each robot, by how much [ns] its latest message came after its stamp
    clocks : the same of its odometry for a while
    timeline : whether time has jumped back

    """

    def __init__(
        self, consumer: Consumer, robot_topics: Mapping[str, str] = ROBOT_TOPICS,
        resets_on_time_jump: bool = False,
    ) -> None:
        self._consumer = consumer
        self._robot_topics = robot_topics
        self.unused: Counter[str] = Counter()
        self.delays: dict[str, int] = {}
        self.clocks = Clocks()
        self.time_jump_detector = TimeJumpDetector(consumer, resets_on_time_jump)
        self._frames: defaultdict[str, set[str]] = defaultdict(set)
        self._held: defaultdict[str, list[tuple[str, Message, int | None]]] = defaultdict(list)
        self._odometry_frames: dict[str, str] = {}
        self._receivers: dict[str, Callable[[RobotSettings, Message, int | None], None]] = {
            'odom': self._receive_odometry,
            'landmarks': self._receive_scan,
            'robots': self._receive_robot_scan,
            'ground_truth': self._receive_truth,
            'set_pose': self._receive_given_pose,
        }

    @property
    def topics(self) -> dict[str, str]:
        """Return what to listen to for the present team, the type name by topic."""
        return {
            f'{name}/{kind}': type_name
            for name in self._consumer.robots for kind, type_name in self._robot_topics.items()
        } | {TRUE_LANDMARKS: CLOUD}

    def receive(self, arrived: RawMessage) -> None:
        """Pass on what is in a message, or count why not."""
        name, _, kind = arrived.topic.rpartition('/')
        if arrived.topic == TRUE_LANDMARKS:
            self._receive_landmarks(arrived)
        elif kind not in self._robot_topics or '/' in name:
            self.unused[arrived.topic] += 1
        elif name not in self._consumer.robots:
            self._consumer.statistics.reject_message(name, arrived.received or 0, RejectionReason.UNKNOWN_ROBOT)
        else:
            message = self._decoded(name, arrived, self._robot_topics[kind])
            if message is not None:
                self._pass_on(kind, self._consumer.robots[name], message, arrived.received)

    def close(self) -> None:
        """Pass on or refuse what still waits: the input has ended."""
        self.time_jump_detector.close()
        for name in [*self._held]:
            self._refuse_held(name, RejectionReason.WRONG_FRAME)

    def forget(self, robot: str) -> None:
        """Forget what a robot that has left has said of its frames."""
        self._refuse_held(robot, RejectionReason.LEFT)
        self._frames.pop(robot, None)
        self._odometry_frames.pop(robot, None)
        self.delays.pop(robot, None)
        self.clocks.forget(robot)
        self.time_jump_detector.forget(robot)

    def odometry_frame(self, robot: str) -> str:
        """Return the frame that a robot's odometry named first, else ``<robot>/odom``."""
        named = [*self._odometry_frames.values()]
        frame = self._odometry_frames.get(robot, '')
        is_own = named.count(frame) == 1 and frame not in {'', MAP, own_frame(robot)}
        return frame if is_own else f'{robot}/odom'

    def snapshot(self) -> dict[str, Any]:
        """Return as plain data what a checkpoint keeps."""
        return {
            'unused': self.unused,
            'odometry_frames': self._odometry_frames,
            'frames': {name: sorted(frames) for name, frames in self._frames.items()},
            'held': {
                name: [
                    [kind, np.frombuffer(serialize(cloud), np.uint8), then]
                    for kind, cloud, then in held]
                for name, held in self._held.items()},
        }

    def restore(self, kept: dict[str, Any]) -> None:
        """Go on where a snapshot was taken."""
        self.unused.update(kept['unused'])
        self._odometry_frames = kept['odometry_frames']
        for name, frames in kept['frames'].items():
            self._frames[name].update(frames)
        for name, held in kept['held'].items():
            self._held[name] = [
                (kind, deserialize(raw.tobytes(), CLOUD), then) for kind, raw, then in held]

    def _decoded(self, name: str, arrived: RawMessage, type_name: str) -> Message | None:
        if arrived.type_name == type_name:
            try:
                return deserialize(arrived.raw, type_name)
            # A message cut short makes the deserialiser stumble in as many ways as it can end.
            except Exception:  # noqa: BLE001, S110
                pass
        self._consumer.statistics.reject_message(name, arrived.received or 0, RejectionReason.BAD_MESSAGE)
        return None

    def _pass_on(
        self, kind: str, robot: RobotSettings, message: Message, received: int | None
    ) -> None:
        stamp = from_time(message.header.stamp)
        if message.header.stamp.nanosec >= NS:
            self._consumer.statistics.reject_message(robot.name, stamp, RejectionReason.BAD_STAMP)
            return
        if received is not None:
            self.delays[robot.name] = received - stamp
            if kind == 'odom':
                self.clocks.add(robot.name, received - stamp)
        try:
            self._receivers[kind](robot, message, received)
        except incoming.RejectedError as rejected:
            self._consumer.statistics.reject_message(robot.name, stamp, rejected.reason)

    def _receive_odometry(
        self, robot: RobotSettings, message: Message, received: int | None
    ) -> None:
        if not self.time_jump_detector.add(incoming.odometry(message, robot.name), received):
            return
        self._odometry_frames.setdefault(robot.name, message.header.frame_id.lstrip('/'))
        if len(self._frames[robot.name]) < MAX_FRAMES:
            self._frames[robot.name].add(message.child_frame_id.lstrip('/'))
        held, self._held[robot.name] = self._held[robot.name], []
        for kind, cloud, then in held:
            self._pass_on(kind, robot, cloud, then)

    def _receive_scan(self, robot: RobotSettings, cloud: Message, received: int | None) -> None:
        if self._is_of_right_frame('landmarks', robot, cloud, received):
            self._add_scan(
                *incoming.scan(cloud, robot, self._consumer.needs_ids), received)

    def _receive_robot_scan(
        self, robot: RobotSettings, cloud: Message, received: int | None
    ) -> None:
        if self._is_of_right_frame('robots', robot, cloud, received):
            names = {other.id: name for name, other in self._consumer.robots.items()}
            self._add_scan(*incoming.robot_scan(cloud, robot, names), received)

    def _is_of_right_frame(
        self, kind: str, robot: RobotSettings, cloud: Message, received: int | None
    ) -> bool:
        """Return whether a cloud is of a right frame; hold it while that is not known."""
        frame = cloud.header.frame_id.lstrip('/')
        known = self._frames[robot.name]
        own = (robot.sensor_frame or '').lstrip('/')
        if frame in {'', f'{robot.name}/base_link', own, *known}:
            return True
        # Until odometry has named its child frame, the scan may be right.
        if known or len(self._held[robot.name]) >= MAX_HELD:
            raise incoming.RejectedError(RejectionReason.WRONG_FRAME)
        self._held[robot.name].append((kind, cloud, received))
        return False

    def _add_scan(self, scan: AnyScan, rejected: list[Rejection], received: int | None) -> None:
        for rejection in rejected:
            self._consumer.statistics.reject(rejection)
        if rejected and not scan.observations:
            # It saw something, nobody knows what: that is no step of the robot.
            self._consumer.statistics.count_empty_scan(scan.robot)
        else:
            self.time_jump_detector.add(scan, received)

    def _receive_truth(self, robot: RobotSettings, message: Message, received: int | None) -> None:
        self.time_jump_detector.add(incoming.true_pose(message, robot.name), received)

    def _receive_given_pose(
        self, robot: RobotSettings, message: Message, received: int | None
    ) -> None:
        self.time_jump_detector.add(incoming.given_pose(message, robot.name), received)

    def _receive_landmarks(self, arrived: RawMessage) -> None:
        cloud = self._decoded('', arrived, CLOUD)
        if cloud is None:
            return
        try:
            self._consumer.add(incoming.true_landmarks(cloud))
        except incoming.RejectedError as rejected:
            self._consumer.statistics.reject_message('', from_time(cloud.header.stamp), rejected.reason)

    def _refuse_held(self, robot: str, reason: RejectionReason) -> None:
        for _, cloud, _ in self._held.pop(robot, []):
            self._consumer.statistics.reject_message(robot, from_time(cloud.header.stamp), reason)
