# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether scans of a laser that turns have the duration and the stamps that they state."""

from collections import defaultdict, deque
import math
from statistics import median

from fej_slam_ros.core.records import NS
from fej_slam_ros.detection.detector import MAX_LASERS
from fej_slam_ros.detection.laser_scan import LaserScan

#: Number of times between scans, or delays, whose median is used, and the smallest number that is
#: sufficient.
MAX_INTERVALS, MIN_INTERVALS = 50, 10
#: Smallest share of a turn that a turning laser covers; a camera, whose beams are measured at
#: once, covers less.
MIN_SHARE = 0.5
#: Ratios of the stated to the expected duration beyond which it is wrong: with half of the scans
#: lost it is 0.5, while drivers that are known to be wrong are so by factors of 3 to 20.
MIN_RATIO, MAX_RATIO = 0.4, 2.0
#: Shortest duration of a scan [ns] whose delay shows when it began, and share of it by which a
#: scan must arrive after odometry of the same stamp: it is sent when it is complete.
MIN_DURATION, MIN_DELAY_SHARE = NS // 50, 0.3
#: Share of a scan by which it seems to arrive before odometry of the same stamp, at least, if its
#: clock is ahead of that of odometry: with the stamp of its last beam it arrives at the same time.
CLOCK_SHARE = 0.5
#: Smallest stamp of a clock that is not that of a simulator, which begins at 0: in 2001 [ns].
MIN_REAL_STAMP = 1_000_000_000 * NS


class ScanTiming:
    """The durations and intervals of the scans of a robot, by laser."""

    def __init__(self) -> None:
        self._newest: dict[str, int] = {}
        self._intervals: defaultdict[str, deque[int]] = defaultdict(
            lambda: deque(maxlen=MAX_INTERVALS))
        self._odometry_delays: deque[int] = deque(maxlen=MAX_INTERVALS)
        self._scan_delays: deque[int] = deque(maxlen=MAX_INTERVALS)
        #: what is wrong with the duration, the stamp and the clock of the latest scan, '' if
        #: nothing is
        self.fault = self.stamp_fault = self.clock_fault = ''
        #: whether the latest scan is that of a real laser that turns, without any time
        self.is_missing = False

    def add_odometry(self, delay: int) -> None:
        """Add the time from the stamp of odometry to its reception [ns]."""
        self._odometry_delays.append(delay)

    def add_delay(self, delay: int, duration: int) -> None:
        """Add the time from the stamp of a scan to its reception, and its duration [ns]."""
        self._scan_delays.append(delay)
        self.stamp_fault = self.clock_fault = ''
        delays = self._odometry_delays, self._scan_delays
        # Log times of a converted bag are the stamps.
        if (duration < MIN_DURATION or min(map(len, delays)) < MIN_INTERVALS
                or not any(map(any, delays))):
            return
        later = median(self._scan_delays) - median(self._odometry_delays)
        if later < -CLOCK_SHARE * duration:
            self.clock_fault = (
                f'the scans arrive {-later / NS:.3g} s before odometry of the same stamp, so that'
                ' their clock seems to be ahead of that of odometry')
        elif later < MIN_DELAY_SHARE * duration:
            self.stamp_fault = (
                f'the scans last {round(duration / 1e6)} ms, but arrive {round(later / 1e6)} ms'
                ' later than odometry of the same stamp, so that they seem to have the stamps of'
                ' their last beams')

    def add(self, laser: str, stamp: int, scan: LaserScan, scan_time: float) -> None:
        """
        Add a scan.

        Parameters
        ----------
        laser : its frame
        stamp : of its first beam [ns]
        scan : its content
        scan_time : stated time between scans [s], 0 if unknown; of simulators that measure all
            beams at once, it and the time between beams are 0

        """
        self.fault = ''
        interval = scan_time * NS or self._interval(laser, stamp)
        is_stated = scan_time > 0.0 or scan.time_increment > 0.0
        share = min(abs(scan.angle_increment) * len(scan.ranges) / (2.0 * math.pi), 1.0)
        self.is_missing = not is_stated and share >= MIN_SHARE and stamp >= MIN_REAL_STAMP
        if not is_stated or not interval or share < MIN_SHARE:
            return
        is_right = MIN_RATIO * share * interval <= scan.duration <= MAX_RATIO * share * interval
        self.fault = '' if is_right else (
            f'the scans of {laser!r} cover {math.degrees(2.0 * math.pi * share):.0f} degrees every'
            f' {interval / NS:.3g} s, but take {scan.duration / NS:.3g} s by their time_increment,'
            ' so that they are corrected wrongly for the motion of the robot')

    def _interval(self, laser: str, stamp: int) -> float:
        """Return the median time between the latest scans of a laser [ns], 0 if unknown."""
        if laser not in self._newest and len(self._newest) >= MAX_LASERS:
            return 0.0
        intervals = self._intervals[laser]
        if laser in self._newest:
            intervals.append(stamp - self._newest[laser])
        self._newest[laser] = stamp
        return median(intervals) if len(intervals) >= MIN_INTERVALS else 0.0
