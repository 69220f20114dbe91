# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the detector, live or from a bag: scans and odometry in, landmarks out."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation, transform
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import numbered_robots
from fej_slam_ros.detection.detections import Detections
from fej_slam_ros.detection.detector import StampedScan
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.ros.messages import (
    decoded_as, incoming, laser, markers, Message, outgoing, RawMessage)
from fej_slam_ros.ros.messages.laser import ScanFault, ScanFaultError
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.session.front_end import FrontEnd, RobotCounts
from fej_slam_ros.ros.session.outputs import IsWanted, Publication
from fej_slam_ros.ros.session.robot_detector import RobotDetector
from fej_slam_ros.ros.session.sensor_frames import SensorFrames
from fej_slam_ros.ros.topic_types import (
    CLOUD, DIAGNOSTICS_TOPIC, LASER_SCAN, MARKERS_TOPIC, ODOMETRY, OUTPUT_TYPES)


class DetectorSession(FrontEnd):
    """
    Detectors of all robots: messages in, messages out.

    Landmarks have the stamp of the last beam. They are in the base frame of the robot if static
    transforms give the pose of its laser, else in the frame of the laser.

    Attributes
    ----------
    detectors : the detectors by robot

    """

    def __init__(self, settings: DetectorSettings) -> None:
        self._settings = settings
        self.robots = {robot.name: robot for robot in numbered_robots(settings.robots)}
        self._frames = SensorFrames(self.robots, settings.tf_topics)
        self.detectors = {name: RobotDetector(name, settings) for name in settings.robots}
        self.topics = {
            **{f'{name}/scan': LASER_SCAN for name in self.robots},
            **{f'{name}/odom': ODOMETRY for name in self.robots}, **self._frames.topics}
        self.outputs = {
            **{f'{name}/landmarks': CLOUD for name in self.robots},
            **{f'{name}/detection_markers': OUTPUT_TYPES[MARKERS_TOPIC] for name in self.robots},
            DIAGNOSTICS_TOPIC: OUTPUT_TYPES[DIAGNOSTICS_TOPIC]}

    def receive(self, arrived: RawMessage) -> None:
        name, _, kind = arrived.topic.lstrip('/').rpartition('/')
        if self._frames.receive(arrived):
            return
        if name in self.detectors and kind in {'scan', 'odom'}:
            message = decoded_as(arrived, self.topics[f'{name}/{kind}'])
            if kind == 'odom':
                self._receive_odometry(name, message, arrived.received)
            elif message is None:
                self.detectors[name].faults[ScanFault.BAD_MESSAGE] += 1
            else:
                self._receive_scan(name, message, arrived.received)

    def take(self, is_wanted: IsWanted = lambda _: True) -> Iterator[Publication]:
        """
        Yield what is to be published of the scans that wait for no more odometry.

        The robots take turns, so that many scans of one of them do not delay those of others.

        All messages that have arrived must have been added: a later scan shows that odometry of an
        earlier one is missing. Markers are left out where they are not wanted.

        """
        is_more = True
        while is_more:
            is_more = False
            for name, state in self.detectors.items():
                for scan, landmarks in islice(state.detector.take(), 1):
                    is_more = True
                    yield from self._published(name, scan, landmarks, is_wanted)

    def close(self) -> Iterator[Publication]:
        for name, state in self.detectors.items():
            for scan, landmarks in state.detector.close():
                yield from self._published(name, scan, landmarks, lambda _: True)

    def counts(self) -> Iterator[RobotCounts]:
        for name, state in self.detectors.items():
            yield name, state.report(), state.counts(self._frames.rejected.total())

    def _receive_odometry(
        self, name: str, message: Message | None, received: int | None
    ) -> None:
        state = self.detectors[name]
        try:
            if message is None:
                raise incoming.RejectedError(RejectionReason.BAD_MESSAGE)
            record = incoming.odometry(
                message, name, self._settings.of_robots[name].use_odometry_covariance)
        except incoming.RejectedError as rejected:
            state.rejected_odometry[rejected.reason] += 1
            return
        self._frames.names.add(name, message)
        state.odometry += 1
        state.detector.add_odometry(record)
        if received is not None:
            state.timing.add_odometry(received - record.stamp)

    def _receive_scan(self, name: str, message: Message, received: int | None) -> None:
        state = self.detectors[name]
        try:
            duration = self._settings.scan_duration
            stamp, scan = laser.laser_scan(message, duration)
            stamp -= scan.duration if self._settings.stamped_at_end else 0
            if self._settings.intensity_threshold > 0.0 and scan.intensities is None:
                raise ScanFaultError(ScanFault.NO_INTENSITIES)
            if self._settings.reversed_beams:
                scan = scan.reversed()
            frame = message.header.frame_id.lstrip('/')
            scan, mount, published = self._mounted(name, frame, scan)
            if not state.detector.add_scan(StampedScan(stamp, scan, mount, published, frame)):
                raise ScanFaultError(ScanFault.LATE)
            state.has_frame = frame != ''
            # Drivers with wrong times between beams state wrong times between scans, too.
            state.timing.add(frame, stamp, scan, 0.0 if duration else message.scan_time)
            if received is not None:
                state.timing.add_delay(received - stamp, scan.duration)
        except ScanFaultError as rejected:
            state.faults[rejected.fault] += 1

    def _mounted(
        self, name: str, frame: str, scan: LaserScan
    ) -> tuple[LaserScan, Array, str]:
        """Return a scan as of an upright laser, its pose (3,), and the frame to publish in."""
        given = self._settings.of_robots[name].sensor_pose
        if given is not None:
            return scan, np.array(given), frame
        pose, base = self._frames.pose(name, frame), self._frames.names.base(name)
        self.detectors[name].note_laser(frame, base, is_known=pose is not None)
        if pose is None:
            return scan, np.zeros(3), frame
        return *_upright(scan, pose), base

    def _published(
        self, name: str, scan: StampedScan, landmarks: Detections, is_wanted: IsWanted
    ) -> Iterator[Publication]:
        state, frame = self.detectors[name], scan.frame
        mount = np.zeros(3) if frame == scan.laser else scan.mount
        C = rotation(mount[2])
        points, R = transform(mount, landmarks.points), C @ landmarks.R @ C.T
        state.landmarks += len(points)
        state.radii.extend(landmarks.radii.tolist())
        stamp = state.stamps.of(scan.end, scan.laser)
        yield f'{name}/landmarks', outgoing.detections(
            stamp, frame, [NO_ID] * len(points), points, R)
        if is_wanted(f'{name}/detection_markers'):
            yield f'{name}/detection_markers', markers.detection_markers(
                stamp, frame, points, R, landmarks.radii)


def _upright(scan: LaserScan, pose: Array) -> tuple[LaserScan, Array]:
    """Return a scan as of an upright laser, and its pose (3,), for a laser at a pose (4, 4)."""
    if pose[2, 2] <= -math.cos(incoming.MAX_TILT):
        # Upside down: seen from above, its beams turn the other way.
        turned = replace(
            scan, angle_min=-scan.angle_min, angle_increment=-scan.angle_increment)
        return turned, np.array([pose[0, 3], pose[1, 3], math.atan2(pose[1, 0], pose[0, 0])])
    try:
        return scan, np.array(incoming.planar_mount(pose))
    except incoming.RejectedError:
        raise ScanFaultError(ScanFault.TILTED) from None
