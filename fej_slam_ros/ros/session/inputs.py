# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversion of serialised messages of topics and bags to records of estimator and smoother."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fej_slam_ros.core.ordering.consumer import Consumer
from fej_slam_ros.core.ordering.time_jump import TimeJumpDetector
from fej_slam_ros.core.records import (
    AnyScan, is_too_uncertain, NS, Odometry, PosePrior, RobotScan, Scan, TruePose)
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.core.snapshot import from_plain, to_plain
from fej_slam_ros.ros.files.checkpoint import refusing_malformed
from fej_slam_ros.ros.messages import (
    decoded_as, deserialize, incoming, incoming_clouds, Message, RawMessage, serialize)
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.parameters import NodeSettings, RESERVED_NAMES
from fej_slam_ros.ros.session.frames import FrameNames
from fej_slam_ros.ros.session.input_health import InputHealth
from fej_slam_ros.ros.session.late_starts import ArrivedOdometry, HeldOdometry, StartCheck
from fej_slam_ros.ros.session.sensor_mounts import SensorMounts
from fej_slam_ros.ros.session.topic_flow import LargeScan
from fej_slam_ros.ros.topic_types import (
    CLOUD, expected_topics, INITIALPOSE, ODOMETRY, ROBOT_TOPICS, STATIC_TF, TF_TYPE,
    TRUE_LANDMARKS)

#: The last part of the names of the topics, by the type of their records.
TOPIC_KINDS = {
    Odometry: 'odom', Scan: 'landmarks', RobotScan: 'robots', TruePose: 'ground_truth',
    PosePrior: 'set_pose'}
#: Maximum number of scans of a robot that wait for its first odometry, whose child frame is valid
#: for scans; further scans are rejected. 1000 scans are minutes at usual rates.
MAX_WAITING_SCANS = 1000
#: Maximum bytes of the points in these.
MAX_WAITING_BYTES = 16_000_000


class Inputs:
    """
    Converts messages to records; bad data is rejected and counted here.

    Parameters
    ----------
    consumer : estimator or smoother that receives the records and counts rejections
    settings : of the node

    Attributes
    ----------
    frames : names of frames, in part from the odometry
    mounts : poses of the sensors, from static transforms
    unused : number of messages on each topic that is not used
    time_jump_detector : passes the records on, and detects that time jumps back
    health : whether messages arrive, and are used
    on_odometry : called with the record and the message of each accepted odometry
    start_check : decides whether start poses hold at the first odometry
    initialpose_robot : robot that `INITIALPOSE` is for, '' for the only one; set by the caller

    """

    #: Types of the topics of each robot that are used, by the last part of their names.
    robot_topics: Mapping[str, str] = ROBOT_TOPICS

    def __init__(self, consumer: Consumer, settings: NodeSettings) -> None:
        self._consumer = consumer
        self._map_frame = settings.map_frame
        self.unused: Counter[str] = Counter()
        self.time_jump_detector = TimeJumpDetector(consumer, settings.on_time_jump == 'reset')
        self.frames = FrameNames(consumer, settings)
        self.mounts = SensorMounts(self.frames)
        self.health = InputHealth(consumer)
        self.on_odometry: Callable[[Odometry, Message], None] = lambda record, message: None
        self.initialpose_robot = ''
        self._waiting_scans: defaultdict[str, list[tuple[str, Message, int | None]]] = (
            defaultdict(list))
        self.start_check = StartCheck()

    @property
    def topics(self) -> dict[str, str]:
        """Return the types of the topics to subscribe to for the present team, by topic."""
        return expected_topics(self._consumer.robots, self.robot_topics)

    @property
    def static_topics(self) -> dict[str, str]:
        """Return the types of the topics of static transforms, by topic."""
        return {
            topic: TF_TYPE for name in self._consumer.robots
            for topic in self.frames.static_topics(name)}

    def receive(self, arrived: RawMessage) -> None:
        """Pass on the record in a message, or count its rejection."""
        if arrived.topic == INITIALPOSE and (robot := self.robot_of_initialpose()) is not None:
            arrived = replace(arrived, topic=f'{robot}/set_pose')
        name, _, kind = arrived.topic.rpartition('/')
        if arrived.topic == TRUE_LANDMARKS:
            self._receive_landmarks(arrived)
        elif kind == STATIC_TF and self._uses_static(arrived.topic):
            for reason in self.mounts.receive(arrived):
                self._reject('', arrived.received or 0, reason)
        elif kind not in self.robot_topics or '/' in name or name in RESERVED_NAMES:
            self.unused[arrived.topic] += 1
        elif name not in self._consumer.robots:
            self._reject(name, arrived.received or 0, RejectionReason.UNKNOWN_ROBOT)
        else:
            self._receive_from_robot(name, kind, arrived)

    def robot_of_initialpose(self) -> str | None:
        """Return the robot that `INITIALPOSE` is for, None if it is not used."""
        robots = [*self._consumer.robots]
        if 'set_pose' not in self.robot_topics or (not self.initialpose_robot and robots[1:]):
            return None
        return self.initialpose_robot or robots[0]

    def time_jump_error(self) -> str:
        """Return what users have to know once time has jumped back, '' before."""
        jump = self.time_jump_detector.jump
        return '' if jump is None else (
            f'time jumped back by {jump.length / NS:.3f} s, all input is rejected: call ~/reset to'
            ' start a new run')

    def close(self) -> None:
        """Pass on or reject the waiting messages at the end of the input."""
        for arrived in self.start_check.close():
            self._add_odometry(arrived)
            self._pass_on_waiting_scans(arrived.record.robot)
        self.time_jump_detector.close()
        for name in [*self._waiting_scans]:
            self._reject_waiting_scans(name, RejectionReason.WRONG_FRAME)

    def continue_from(self, earlier: 'Inputs') -> None:
        """Take over static transforms, which are sent once, and input since time jumped."""
        self.mounts.restore(earlier.mounts.snapshot())
        if (jump := earlier.time_jump_detector.jump) is not None:
            self.frames.restore(earlier.frames.snapshot())
            self.time_jump_detector.follow(jump)

    def remove_robot(self, robot: str) -> None:
        """Delete the state of a robot that was removed, and reject its waiting messages."""
        for arrived in self.start_check.remove_robot(robot):
            self._reject(robot, arrived.record.stamp, RejectionReason.LEFT)
        self._reject_waiting_scans(robot, RejectionReason.LEFT)
        self.frames.remove_robot(robot)
        self.time_jump_detector.forget(robot)
        self.health.remove_robot(robot)

    def snapshot(self) -> dict[str, Any]:
        """Return the state for a checkpoint as plain data."""
        return {
            'unused': self.unused,
            'time_jump': to_plain(self.time_jump_detector.snapshot(), self._consumer.settings),
            **self.frames.snapshot(),
            'mounts': self.mounts.snapshot(),
            'held_odometry': {
                robot: [held.missed, [[_bytes(odom), at] for _, odom, at in held.arrived]]
                for robot, held in self.start_check.held().items()},
            'waiting_scans': {
                robot: [[kind, _bytes(cloud), at] for kind, cloud, at in scans]
                for robot, scans in self._waiting_scans.items()},
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Restore the state of a snapshot."""
        self.unused.update(stored['unused'])
        self.time_jump_detector.resume(
            from_plain(stored['time_jump'], self._consumer.settings))
        self.frames.restore(stored)
        self.mounts.restore(stored['mounts'])
        self.start_check = StartCheck({
            robot: HeldOdometry(missed, [
                _arrived(deserialize(raw.tobytes(), ODOMETRY), self._consumer.robots[robot], at)
                for raw, at in arrived])
            for robot, (missed, arrived) in stored['held_odometry'].items()})
        for robot, scans in stored['waiting_scans'].items():
            self._waiting_scans[robot] = [
                (kind, deserialize(raw.tobytes(), CLOUD), at) for kind, raw, at in scans]

    def _receive_from_robot(self, name: str, kind: str, arrived: RawMessage) -> None:
        """Pass on a message on a topic of a robot, and note whether it is rejected."""
        detector = self.time_jump_detector
        rejected, held = self._consumer.statistics.rejected.get(name, 0), detector.count_held()
        if not self._reject_too_large(name, kind, arrived):
            message = self._decoded(name, arrived, self.robot_topics[kind])
            if message is not None:
                self._pass_on(kind, self._consumer.robots[name], message, arrived.received)
        self.health.receive(name, kind, arrived.received)
        if detector.settled:
            rejected += self._note_settled(name)
        if detector.count_held() <= held:
            self.health.settle(name, kind, arrived.received, self._reason_since(name, rejected))
        if kind == 'odom' and name in self._waiting_scans and self.frames.knows_base(name):
            self._pass_on_waiting_scans(name)

    def _note_settled(self, robot: str) -> int:
        """Note which held messages are accepted; return how many of a robot are rejected."""
        settled = [*self.time_jump_detector.settled]
        self.time_jump_detector.settled.clear()
        for record, received, reason in settled:
            self.health.settle(record.robot, TOPIC_KINDS[type(record)], received, reason)
        return sum(record.robot == robot and reason is not None for record, _, reason in settled)

    def _reason_since(self, robot: str, rejected: int) -> RejectionReason | None:
        """Return the newest reason if more messages of a robot are rejected than before."""
        statistics = self._consumer.statistics
        is_rejected = statistics.rejected.get(robot, 0) > rejected
        return statistics.rejections[-1].reason if is_rejected else None

    def _pass_on_waiting_scans(self, robot: str) -> None:
        """Pass on the scans that have waited for the first odometry of a robot."""
        for kind, cloud, received in self._waiting_scans.pop(robot, []):
            rejected = self._consumer.statistics.rejected.get(robot, 0)
            self._pass_on(kind, self._consumer.robots[robot], cloud, received)
            reason = self._reason_since(robot, rejected)
            if reason is not None:
                self.health.settle(robot, kind, received, reason)

    def _decoded(self, name: str, arrived: RawMessage, type_name: str) -> Message | None:
        message = decoded_as(arrived, type_name)
        if message is None:
            self._reject(name, arrived.received or 0, RejectionReason.BAD_MESSAGE)
        return message

    def _reject_too_large(self, name: str, kind: str, arrived: RawMessage) -> bool:
        """Reject a scan of too many points, by its header; return whether it has."""
        if arrived.type_name != CLOUD or self.robot_topics[kind] != CLOUD:
            return False
        points = incoming_clouds.points_beyond(
            arrived.raw, self._consumer.settings.max_observations)
        if points is None:
            return False
        self.health.flow(name, kind).largest = LargeScan(
            points, len(arrived.raw), arrived.received)
        self._reject(name, arrived.received or 0, RejectionReason.TOO_LARGE)
        return True

    def _pass_on(
        self, kind: str, robot: RobotSettings, message: Message, received: int | None
    ) -> None:
        stamp = from_time(message.header.stamp)
        if message.header.stamp.nanosec >= NS:
            self._reject(robot.name, stamp, RejectionReason.BAD_STAMP)
            return
        if received is not None:
            self.health.receive_delay(robot.name, kind, received - stamp)
        try:
            if kind == 'odom':
                for admitted in self.start_check.admit(_arrived(message, robot, received)):
                    self._add_odometry(admitted)
            elif kind == 'ground_truth':
                self.time_jump_detector.add(incoming.true_pose(message, robot.name), received)
            elif kind == 'set_pose':
                prior = incoming.pose_prior(message, robot.name, self._map_frame)
                if self.time_jump_detector.add(prior, received):
                    self.health.receive_pose_prior(
                        robot.name, stamp, not is_too_uncertain(prior.P))
            elif (mounted := self._mounted(robot, message.header.frame_id)) is not None:
                self._receive_scan(kind, mounted, message, received)
            else:
                self._let_wait(kind, robot.name, message, received)
        except incoming.RejectedError as rejected:
            self._reject(robot.name, stamp, rejected.reason)

    def _add_odometry(self, arrived: ArrivedOdometry) -> None:
        record, message, received = arrived
        if not self.time_jump_detector.add(record, received):
            return
        velocity = message.twist.twist
        self.health.receive_odometry(record.robot, record.stamp)
        self.health.robots[record.robot].receive_velocity(
            record.pose, (velocity.linear.x, velocity.angular.z), record.twist_covariance)
        self.frames.add(record.robot, message)
        self.on_odometry(record, message)

    def _mounted(self, robot: RobotSettings, frame: str) -> RobotSettings | None:
        """Return a robot with the pose of the sensor of a frame, None if that is unknown."""
        frame, of_sensor = frame.lstrip('/'), (robot.sensor_frame or '').lstrip('/')
        if frame == of_sensor or self.frames.is_base(robot.name, frame):
            return robot
        pose = self.mounts.pose(robot.name, frame)
        return None if pose is None else replace(robot, sensor_pose=incoming.planar_mount(pose))

    def _let_wait(self, kind: str, robot: str, cloud: Message, received: int | None) -> None:
        """Store a scan until odometry names the base frame; after that its frame is wrong."""
        waiting = self._waiting_scans[robot]
        size = len(cloud.data) + sum(len(other.data) for _, other, _ in waiting)
        is_full = len(waiting) >= MAX_WAITING_SCANS or size > MAX_WAITING_BYTES
        if self.frames.knows_base(robot) or is_full:
            raise incoming.RejectedError(RejectionReason.WRONG_FRAME)
        waiting.append((kind, cloud, received))

    def _receive_scan(
        self, kind: str, robot: RobotSettings, cloud: Message, received: int | None
    ) -> None:
        scan: AnyScan
        if kind == 'landmarks':
            scan, rejected = incoming_clouds.scan(cloud, robot, self._consumer.needs_ids)
        else:
            names = {other.id: name for name, other in self._consumer.robots.items()}
            scan, rejected = incoming_clouds.robot_scan(cloud, robot, names)
        for rejection in rejected:
            self._consumer.statistics.reject(rejection)
        if rejected and not scan.observations:
            # Unlike an empty scan, one whose observations are all rejected is not a step.
            self._consumer.statistics.count_fully_rejected_scan(scan.robot)
        else:
            self.health.flow(scan.robot, kind).observations += len(scan.observations)
            self.time_jump_detector.add(scan, received)

    def _receive_landmarks(self, arrived: RawMessage) -> None:
        cloud = self._decoded('', arrived, CLOUD)
        if cloud is None:
            return
        try:
            self._consumer.add(incoming_clouds.true_landmarks(cloud))
        except incoming.RejectedError as rejected:
            self._reject('', from_time(cloud.header.stamp), rejected.reason)

    def _uses_static(self, topic: str) -> bool:
        return topic.lstrip('/') in {name.lstrip('/') for name in self.static_topics}

    def _reject_waiting_scans(self, robot: str, reason: RejectionReason) -> None:
        for kind, cloud, received in self._waiting_scans.pop(robot, []):
            self._reject(robot, from_time(cloud.header.stamp), reason)
            self.health.settle(robot, kind, received, reason)

    def _reject(self, robot: str, stamp: int, reason: RejectionReason) -> None:
        self._consumer.statistics.reject_message(robot, stamp, reason)


def restored_inputs(
    path: Path, stored: dict[str, Any], consumer: Consumer, settings: NodeSettings
) -> Inputs:
    """Return the inputs of a saved run, as they are stored in its checkpoint."""
    inputs = Inputs(consumer, settings)
    with refusing_malformed(path):
        inputs.restore(stored)
    return inputs


def _arrived(message: Message, robot: RobotSettings, received: int | None) -> ArrivedOdometry:
    record = incoming.odometry(message, robot.name, robot.use_odometry_covariance)
    return ArrivedOdometry(record, message, received)


def _bytes(message: Message) -> Any:
    """Return a message as an array for a checkpoint."""
    return np.frombuffer(serialize(message), np.uint8)
