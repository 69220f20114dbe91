# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the detector, live or from a bag: scans and odometry in, landmarks out."""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
import math
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, rotation, transform
from fej_slam_ros.core.records import NO_ID
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import RobotSettings
from fej_slam_ros.detection.detections import Detections
from fej_slam_ros.detection.detector import Detector, StampedScan
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.ros.messages import (
    decoded_as, incoming, laser, markers, Message, outgoing, RawMessage)
from fej_slam_ros.ros.messages.laser import ScanFault, ScanFaultError
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.session.distinct_stamps import DistinctStamps, MAX_SENSORS
from fej_slam_ros.ros.session.front_end import RobotCounts
from fej_slam_ros.ros.session.inputs import CLOUD, ODOMETRY
from fej_slam_ros.ros.session.outputs import (
    DIAGNOSTICS_TOPIC, IsWanted, MARKERS_TOPIC, Publication, TYPES)
from fej_slam_ros.ros.session.scan_timing import ScanTiming
from fej_slam_ros.ros.session.sensor_frames import SensorFrames

LASER_SCAN = 'sensor_msgs/msg/LaserScan'
#: Number of radii that are stored for each robot.
MAX_RADII = 1_000
#: Number of waiting scans above which processing is too slow: a laser sends fewer in the second
#: for which a scan waits for odometry.
MANY_WAITING = 500


class Condition(NamedTuple):
    """Something that users have to know of the scans of a robot."""

    name: str  #: in one word, as a finding of ``doctor``
    what: str  #: description
    cure: str  #: what the user can do, '' if the description says it


class _RobotDetector:
    """The detector of one robot, and counts of its messages."""

    def __init__(self, settings: DetectorSettings) -> None:
        self.detector = Detector(settings.method(), settings.min_beams, settings.static_time)
        self.faults: Counter[ScanFault] = Counter()
        self.rejected_odometry: Counter[RejectionReason] = Counter()
        self.odometry = self.landmarks = 0
        #: frames of lasers whose places on the robot are not known
        self.unknown_frames: set[str] = set()
        self.base_frame = ''  #: to which no transform from these frames leads
        self.has_frame = True  #: whether the latest scan names its frame
        self.stamps = DistinctStamps()
        self.timing = ScanTiming()


class DetectorSession:
    """
    Detectors of all robots: messages in, messages out.

    Landmarks have the stamp of the last beam. They are in the base frame of the robot if static
    transforms give the pose of its laser, else in the frame of the laser.

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
        self._sensor_poses = {
            name: of_robot.sensor_pose
            for name, of_robot in zip(settings.robots, settings.of_robots)}
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
            if kind == 'odom':
                self._receive_odometry(name, message, arrived.received)
            elif message is None:
                self._detectors[name].faults[ScanFault.BAD_MESSAGE] += 1
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
                **{f'odometry_{reason.value}': n for reason, n in sorted(
                    state.rejected_odometry.items(), key=lambda item: item[0].value)},
                'scans': detector.scans, 'landmarks': state.landmarks,
                'scans_without_odometry': detector.without_odometry, 'scans_lost': detector.lost,
                'time_jumps': detector.restarts,
                'transforms_rejected': self._frames.rejected.total(),
                **{f'scans_{fault.value}': n for fault, n in sorted(
                    state.faults.items(), key=lambda item: item[0].value)},
                **{f'segments_{reason.value}': n for reason, n in sorted(
                    detector.rejected.items(), key=lambda item: item[0].value) if n}}
            first = next(_conditions(name, state), None)
            yield name, '' if first is None else ': '.join(filter(None, first[1:])), values

    def conditions(self, robot: str) -> list[Condition]:
        """Return what users have to know of the scans of a robot, the most serious first."""
        return [*_conditions(robot, self._detectors[robot])]

    def _receive_odometry(
        self, name: str, message: Message | None, received: int | None
    ) -> None:
        state = self._detectors[name]
        try:
            if message is None:
                raise incoming.RejectedError(RejectionReason.BAD_MESSAGE)
            record = incoming.odometry(message, name)
        except incoming.RejectedError as rejected:
            state.rejected_odometry[rejected.reason] += 1
            return
        self._frames.add_odometry(name, message)
        state.odometry += 1
        state.detector.add_odometry(record)
        if received is not None:
            state.timing.add_odometry(received - record.stamp)

    def _receive_scan(self, name: str, message: Message, received: int | None) -> None:
        state = self._detectors[name]
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
        given = self._sensor_poses[name]
        if given is not None:
            return scan, np.array(given), frame
        pose = self._frames.pose(name, frame)
        unknown = self._detectors[name].unknown_frames
        if pose is not None:
            unknown.discard(frame)
        elif len(unknown) < MAX_SENSORS:
            unknown.add(frame)
            self._detectors[name].base_frame = self._frames.base(name)
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
        state, frame = self._detectors[name], scan.frame
        mount = np.zeros(3) if frame == scan.laser else scan.mount
        C = rotation(mount[2])
        points, R = transform(mount, landmarks.points), C @ landmarks.R @ C.T
        state.landmarks += len(points)
        stamp = state.stamps.of(scan.end, scan.laser)
        self.radii[name].extend(landmarks.radii.tolist())
        yield f'{name}/landmarks', outgoing.detections(
            stamp, frame, [NO_ID] * len(points), points, R)
        if is_wanted(f'{name}/detection_markers'):
            yield f'{name}/detection_markers', markers.detection_markers(
                stamp, frame, points, R, landmarks.radii)


def _conditions(name: str, state: _RobotDetector) -> Iterator[Condition]:
    yield from _conditions_of_use(name, state)
    yield from _conditions_of_place(name, state)
    yield from _conditions_of_odometry(name, state)
    if state.timing.fault:
        yield Condition(
            'scan_duration', state.timing.fault,
            'set scan_duration of the detector to the time in which the laser measures a scan, or'
            ' correct time_increment in the driver; if all beams are measured at once, set'
            ' scan_time to 0 too')
    if state.timing.is_missing:
        yield Condition(
            'scan_times',
            'the scans have neither scan_time nor time_increment, so that they are not corrected'
            ' for the motion of the robot',
            'set scan_duration of the detector to the time in which the laser measures a scan')
    if state.timing.clock_fault:
        yield Condition(
            'scan_stamp', state.timing.clock_fault,
            'stamp both by one clock, or send odometry with less delay')
    if state.timing.stamp_fault:
        yield Condition(
            'scan_stamp', state.timing.stamp_fault,
            'set stamped_at_end of the detector to true if the driver stamps complete scans, or'
            ' send odometry with less delay')
    if state.detector.scans and not state.landmarks:
        yield _no_landmark(state.detector)


def _conditions_of_use(name: str, state: _RobotDetector) -> Iterator[Condition]:
    detector, rejected = state.detector, state.faults.total()
    if detector.waiting > MANY_WAITING:
        yield Condition(
            'slow',
            f'{detector.waiting} scans wait, as they come faster than they are processed',
            'lower their rate or their number of beams')
    if rejected > detector.scans + detector.waiting:
        (fault, count), = state.faults.most_common(1)
        total = rejected + detector.scans + detector.waiting
        number = 'all' if count == total else f'{count} of {total}'
        yield Condition(
            'scans_rejected', f'{number} scans are rejected as {fault.value}', laser.CURES[fault])
    elif not detector.scans:
        yield Condition('no_scans', 'no scans', f'publish them on {name}/scan')


def _conditions_of_place(name: str, state: _RobotDetector) -> Iterator[Condition]:
    if state.unknown_frames:
        yield Condition(
            'laser_frame',
            f'no static transform from the frame {min(state.unknown_frames)!r} of the scans to the'
            f' base frame {state.base_frame!r}',
            f'publish it on /tf_static, or set {name}.sensor_pose here and at the estimator, and'
            f' {name}.sensor_frame there')
    if not state.has_frame:
        yield Condition(
            'laser_frame', 'the scans have no frame_id, so that the laser is taken to be in the'
            ' base frame', 'set it in the driver, and publish the transform of this frame')


def _conditions_of_odometry(name: str, state: _RobotDetector) -> Iterator[Condition]:
    detector = state.detector
    if state.rejected_odometry.total() > state.odometry:
        reason, _ = state.rejected_odometry.most_common(1)[0]
        yield Condition(
            'odometry_rejected', f'most odometry on {name}/odom is rejected as {reason.value}',
            'correct it as the rejection reasons in the documentation of the topics say')
    elif detector.scans and detector.without_odometry == detector.scans:
        yield Condition(
            'no_odometry', 'no odometry around the scans',
            f'publish it on {name}/odom, with stamps of the same clock')


def _no_landmark(detector: Detector) -> Condition:
    if not detector.rejected:
        return Condition(
            'no_returns', 'no landmark so far, as no beam has a return that is used',
            'give ranges, range_min and range_max in metres, and look at intensity_threshold')
    reason, _ = detector.rejected.most_common(1)[0]
    return Condition(
        'no_landmark', f'no landmark so far, most segments are rejected as {reason.value}', '')
