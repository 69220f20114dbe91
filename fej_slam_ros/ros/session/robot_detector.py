# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The detector of one robot: counts of its input, and what users have to know of that."""

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, NamedTuple

from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.detection.detector import Detector
from fej_slam_ros.ros.messages import laser
from fej_slam_ros.ros.messages.laser import ScanFault
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.session.distinct_stamps import DistinctStamps, MAX_SENSORS
from fej_slam_ros.ros.session.front_end import RECENT_REPORTS
from fej_slam_ros.ros.session.scan_timing import ScanTiming

#: Number of waiting scans above which processing is too slow: a laser sends fewer in the second
#: for which a scan waits for odometry.
MANY_WAITING = 500
#: Number of radii of landmarks that are stored.
MAX_RADII = 1_000


class Condition(NamedTuple):
    """Something that users have to know of the scans of a robot."""

    name: str  #: in one word, as a finding of ``doctor``
    what: str  #: description
    cure: str  #: what the user can do, '' if the description says it


@dataclass(frozen=True, slots=True)
class InputCounts:
    """Counts of messages, in all or in some time."""

    scans: int = 0  #: that were used
    without_odometry: int = 0  #: of these
    odometry: int = 0
    faults: Counter[ScanFault] = field(default_factory=Counter)  #: of rejected scans
    rejected_odometry: Counter[RejectionReason] = field(default_factory=Counter)

    def since(self, earlier: 'InputCounts') -> 'InputCounts':
        """Return the counts without those of an earlier time."""
        return InputCounts(
            self.scans - earlier.scans, self.without_odometry - earlier.without_odometry,
            self.odometry - earlier.odometry, self.faults - earlier.faults,
            self.rejected_odometry - earlier.rejected_odometry)


class RobotDetector:
    """The detector of one robot, and counts of its messages."""

    def __init__(self, name: str, settings: DetectorSettings) -> None:
        self._name = name
        self.detector = Detector(settings.method(), settings.min_beams, settings.static_time)
        self.faults: Counter[ScanFault] = Counter()
        self.rejected_odometry: Counter[RejectionReason] = Counter()
        self.odometry = self.landmarks = 0
        self.radii: deque[float] = deque(maxlen=MAX_RADII)  #: of the latest landmarks [m]
        self.has_frame = True  #: whether the latest scan names its frame
        self.stamps = DistinctStamps()
        self.timing = ScanTiming()
        # Frames of lasers whose places on the robot are not known, and the base frame, to which no
        # transform from these leads.
        self._unknown_frames: set[str] = set()
        self._base_frame = ''
        self._earlier = deque([InputCounts()], RECENT_REPORTS)  # at the latest reports

    def note_laser(self, frame: str, base_frame: str, is_known: bool) -> None:
        """Record whether the place of a laser in the base frame is known."""
        if is_known:
            self._unknown_frames.discard(frame)
        elif len(self._unknown_frames) < MAX_SENSORS:
            self._unknown_frames.add(frame)
            self._base_frame = base_frame

    def counts(self, rejected_transforms: int) -> dict[str, int]:
        """Return the counts of scans and landmarks, with that of transforms of all robots."""
        detector = self.detector
        return {
            'odometry': self.odometry, 'odometry_late': detector.late_odometry,
            **_by_reason('odometry', self.rejected_odometry),
            'scans': detector.scans, 'landmarks': self.landmarks,
            'scans_without_odometry': detector.without_odometry, 'scans_lost': detector.lost,
            'time_jumps': detector.restarts, 'transforms_rejected': rejected_transforms,
            **_by_reason('scans', self.faults), **_by_reason('segments', detector.rejected)}

    def conditions(self) -> Iterator[Condition]:
        """Yield what users have to know of all the input, the most serious first."""
        yield from self._conditions(self._input())

    def report(self) -> list[str]:
        """Return the conditions at present, with their cures; to be called each second."""
        counts = self._input()
        conditions = self._conditions(counts.since(self._earlier[0]))
        self._earlier.append(counts)
        return [': '.join(filter(None, condition[1:])) for condition in conditions]

    def _input(self) -> InputCounts:
        return InputCounts(
            self.detector.scans, self.detector.without_odometry, self.odometry,
            self.faults.copy(), self.rejected_odometry.copy())

    def _conditions(self, counts: InputCounts) -> Iterator[Condition]:
        yield from chain(
            self._of_use(counts), self._of_odometry(counts), self._of_place(), self._of_times())
        if self.detector.scans and not self.landmarks:
            yield _no_landmark(self.detector)

    def _of_use(self, counts: InputCounts) -> Iterator[Condition]:
        waiting = self.detector.waiting
        if waiting > MANY_WAITING:
            yield Condition(
                'slow',
                f'more than {MANY_WAITING} scans wait: they come faster than they are processed',
                'lower their rate or their number of beams')
        if counts.faults.total() > counts.scans + waiting:
            (fault, _), = counts.faults.most_common(1)
            number = 'most' if counts.scans + waiting else 'all'
            yield Condition(
                'scans_rejected', f'{number} scans are rejected, most as {fault.value}',
                laser.CURES[fault])
        elif not counts.scans + waiting:
            yield (
                Condition('scans_stopped', 'the scans have stopped', '') if self.detector.scans
                else Condition('no_scans', 'no scans', f'publish them on {self._name}/scan'))

    def _of_place(self) -> Iterator[Condition]:
        if self._unknown_frames:
            yield Condition(
                'laser_frame',
                f'no static transform from the frame {min(self._unknown_frames)!r} of the scans to'
                f' the base frame {self._base_frame!r}',
                f'publish it on /tf_static, or set {self._name}.sensor_pose here and at the'
                f' estimator, and {self._name}.sensor_frame there')
        if not self.has_frame:
            yield Condition(
                'laser_frame',
                'the scans have no frame_id, so that the laser is taken to be in the base frame',
                'set it in the driver, and publish the transform of this frame')

    def _of_odometry(self, counts: InputCounts) -> Iterator[Condition]:
        if counts.rejected_odometry.total() > counts.odometry:
            (reason, _), = counts.rejected_odometry.most_common(1)
            yield Condition(
                'odometry_rejected',
                f'most odometry on {self._name}/odom is rejected as {reason.value}',
                'correct it as the rejection reasons in the documentation of the topics say')
        elif self.odometry and not counts.odometry:
            yield Condition('odometry_stopped', 'the odometry has stopped', '')
        elif counts.scans and counts.without_odometry == counts.scans:
            yield Condition(
                'no_odometry', 'no odometry around the scans',
                f'publish it on {self._name}/odom, with stamps of the same clock')

    def _of_times(self) -> Iterator[Condition]:
        timing = self.timing
        if timing.fault:
            yield Condition(
                'scan_duration', timing.fault,
                'set scan_duration of the detector to the time in which the laser measures a scan,'
                ' or correct time_increment in the driver')
        if timing.is_missing:
            yield Condition(
                'scan_times',
                'the scans have neither scan_time nor time_increment, so that they are not'
                ' corrected for the motion of the robot',
                'set scan_duration of the detector to the time in which the laser measures a scan')
        if timing.clock_fault:
            yield Condition(
                'scan_stamp', timing.clock_fault,
                'stamp both by one clock, or send odometry with less delay')
        if timing.stamp_fault:
            yield Condition(
                'scan_stamp', timing.stamp_fault,
                'set stamped_at_end of the detector to true if the driver stamps complete scans,'
                ' or send odometry with less delay')


def _no_landmark(detector: Detector) -> Condition:
    if not detector.rejected:
        return Condition(
            'no_returns', 'no landmark so far, as no beam has a return that is used',
            'give ranges, range_min and range_max in metres, and look at intensity_threshold')
    reason, _ = detector.rejected.most_common(1)[0]
    return Condition(
        'no_landmark', f'no landmark so far, most segments are rejected as {reason.value}', '')


def _by_reason(what: str, rejected: Counter[Any]) -> dict[str, int]:
    """Return the counts of something that was rejected, in the order of the reasons' names."""
    return {
        f'{what}_{reason.value}': count
        for reason, count in sorted(rejected.items(), key=lambda item: item[0].value) if count}
