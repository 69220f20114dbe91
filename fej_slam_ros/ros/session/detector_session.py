# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the detector, live or from a bag: scans and odometry in, landmarks out."""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation, transform
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.detection.detections import Detections
from fej_slam_ros.detection.detector import Detector, StampedScan
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.ros.messages import (
    decoded_as, incoming, laser, markers, Message, outgoing, RawMessage)
from fej_slam_ros.ros.messages.laser import ScanFault, ScanFaultError
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.session.front_end import RobotCounts
from fej_slam_ros.ros.session.inputs import CLOUD, ODOMETRY
from fej_slam_ros.ros.session.outputs import (
    DIAGNOSTICS_TOPIC, IsWanted, MARKERS_TOPIC, Publication, TYPES)
from fej_slam_ros.ros.session.sensor_frames import SensorFrames

LASER_SCAN = 'sensor_msgs/msg/LaserScan'
#: Number of radii that are stored for each robot.
MAX_RADII = 1_000
#: Number of waiting scans above which processing is too slow: a laser sends fewer in the second
#: for which a scan waits for odometry.
MANY_WAITING = 500


class _RobotDetector:
    """The detector of one robot, and counts of its messages."""

    def __init__(self, settings: DetectorSettings) -> None:
        self.detector = Detector(settings.method(), settings.min_beams, settings.static_time)
        self.faults: Counter[ScanFault] = Counter()
        self.odometry = self.landmarks = 0
        #: frame of the laser whose place on the robot is not known, '' if it is
        self.unknown_frame = ''


class DetectorSession:
    """
    Detectors of all robots: messages in, messages out.

    Landmarks have the stamp of the last beam. They are in the base frame of the robot if the pose
    of its laser is known, else in the frame of the laser.

    Parameters
    ----------
    settings : parameters of the detector

    Attributes
    ----------
    robots : the robots by name
    topics : types of the topics that are read, by topic
    outputs : types of the topics that are published, by topic
    radii : radii of the latest landmarks of each robot [m]

    """

    def __init__(self, settings: DetectorSettings) -> None:
        self._settings = settings
        self.robots = {
            name: RobotSettings(name, k) for k, name in enumerate(settings.robots, start=1)}
        self._frames = SensorFrames(self.robots, settings.tf_topics)
        self._detectors = {name: _RobotDetector(settings) for name in settings.robots}
        self.radii: dict[str, deque[float]] = {
            name: deque(maxlen=MAX_RADII) for name in settings.robots}
        self.topics = {
            **{f'{name}/scan': LASER_SCAN for name in self.robots},
            **{f'{name}/odom': ODOMETRY for name in self.robots}, **self._frames.topics}
        self.outputs = {
            **{f'{name}/landmarks': CLOUD for name in self.robots},
            **{f'{name}/detection_markers': TYPES[MARKERS_TOPIC] for name in self.robots},
            DIAGNOSTICS_TOPIC: TYPES[DIAGNOSTICS_TOPIC]}

    def receive(self, arrived: RawMessage) -> None:
        """Add a message, or count its rejection."""
        name, _, kind = arrived.topic.lstrip('/').rpartition('/')
        if self._frames.receive(arrived):
            return
        if name in self._detectors and kind in {'scan', 'odom'}:
            message = decoded_as(arrived, self.topics[f'{name}/{kind}'])
            if message is None:
                self._detectors[name].faults[ScanFault.BAD_MESSAGE] += 1
            elif kind == 'odom':
                self._receive_odometry(name, message)
            else:
                self._receive_scan(name, message)

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
            for name, state in self._detectors.items():
                for scan, landmarks in islice(state.detector.take(), 1):
                    is_more = True
                    yield from self._published(name, scan, landmarks, is_wanted)

    def close(self) -> Iterator[Publication]:
        """Yield what is to be published of the last scans at the end of the input."""
        for name, state in self._detectors.items():
            for scan, landmarks in state.detector.close():
                yield from self._published(name, scan, landmarks, lambda _: True)

    def counts(self) -> Iterator[RobotCounts]:
        """Yield each robot, a warning or '', and the counts of its scans and landmarks."""
        for name, state in self._detectors.items():
            detector = state.detector
            values = {
                'odometry': state.odometry, 'odometry_late': detector.late_odometry,
                'scans': detector.scans, 'landmarks': state.landmarks,
                'scans_without_odometry': detector.without_odometry, 'scans_lost': detector.lost,
                'time_jumps': detector.restarts,
                'transforms_rejected': self._frames.rejected.total(),
                **{f'scans_{fault.value}': n for fault, n in sorted(
                    state.faults.items(), key=lambda item: item[0].value)},
                **{f'segments_{reason.value}': n for reason, n in sorted(
                    detector.rejected.items(), key=lambda item: item[0].value) if n}}
            yield name, _warning(name, state), values

    def _receive_odometry(self, name: str, message: Message) -> None:
        try:
            record = incoming.odometry(message, name)
        except incoming.RejectedError:
            self._detectors[name].faults[ScanFault.BAD_MESSAGE] += 1
            return
        self._frames.add_odometry(name, message)
        self._detectors[name].odometry += 1
        self._detectors[name].detector.add_odometry(record)

    def _receive_scan(self, name: str, message: Message) -> None:
        state = self._detectors[name]
        try:
            stamp, scan = laser.laser_scan(message)
            if self._settings.intensity_threshold > 0.0 and scan.intensities is None:
                raise ScanFaultError(ScanFault.NO_INTENSITIES)
            frame = message.header.frame_id.lstrip('/')
            scan, mount, published = self._mounted(name, frame, scan)
            if not state.detector.add_scan(StampedScan(stamp, scan, mount, published)):
                raise ScanFaultError(ScanFault.LATE)
        except ScanFaultError as rejected:
            state.faults[rejected.fault] += 1

    def _mounted(
        self, name: str, frame: str, scan: LaserScan
    ) -> tuple[LaserScan, Array, str]:
        """Return a scan as of an upright laser, its pose (3,), and the frame to publish in."""
        pose = self._frames.pose(name, frame)
        self._detectors[name].unknown_frame = frame if pose is None else ''
        if pose is None:
            return scan, np.zeros(3), frame
        base = self._frames.base(name)
        if pose[2, 2] <= -math.cos(incoming.MAX_TILT):
            # Upside down: seen from above, its beams turn the other way.
            turned = replace(
                scan, angle_min=-scan.angle_min, angle_increment=-scan.angle_increment)
            yaw = math.atan2(pose[1, 0], pose[0, 0])
            return turned, np.array([pose[0, 3], pose[1, 3], yaw]), base
        try:
            return scan, np.array(incoming.planar_mount(pose)), base
        except incoming.RejectedError:
            raise ScanFaultError(ScanFault.TILTED) from None

    def _published(
        self, name: str, scan: StampedScan, landmarks: Detections, is_wanted: IsWanted
    ) -> Iterator[Publication]:
        state, frame, C = self._detectors[name], scan.frame, rotation(scan.mount[2])
        points, R = transform(scan.mount, landmarks.points), C @ landmarks.R @ C.T
        state.landmarks += len(points)
        self.radii[name].extend(landmarks.radii.tolist())
        yield f'{name}/landmarks', outgoing.detections(
            scan.end, frame, [NO_ID] * len(points), points, R)
        if is_wanted(f'{name}/detection_markers'):
            yield f'{name}/detection_markers', markers.detection_markers(
                scan.end, frame, points, R, landmarks.radii)


def _warning(name: str, state: _RobotDetector) -> str:
    """Return what users have to know of a robot, '' if all is well."""
    detector = state.detector
    if detector.waiting > MANY_WAITING:
        return (
            f'{detector.waiting} scans wait, as they come faster than they are processed: lower'
            ' their rate or their number of beams')
    if state.faults and not detector.scans:
        fault, _ = state.faults.most_common(1)[0]
        return f'all scans are rejected as {fault.value}'
    if not detector.scans:
        return f'no scans: publish them on {name}/scan'
    if state.unknown_frame:
        return (
            f'no static transform from the frame {state.unknown_frame!r} of the scans to the base'
            ' frame: publish it on /tf_static, or give the estimator sensor_frame and sensor_pose')
    if detector.without_odometry == detector.scans:
        return f'no odometry around the scans: publish it on {name}/odom'
    if not state.landmarks and detector.rejected:
        reason, _ = detector.rejected.most_common(1)[0]
        return f'no landmark so far, most segments are rejected as {reason.value}'
    return ''
