# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The detector of one robot: scans and odometry in, static landmarks out."""

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, interpolated, rotation, transform
from fej_slam_ros.core.records import NS
from fej_slam_ros.detection.detections import Detections, RejectedSegment
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.detection.static_filter import StaticFilter

#: Finds landmarks in a single scan.
ScanDetector = Callable[[LaserScan], Detections]

#: Time by which a later scan shows that odometry of the earlier one does not arrive [ns].
MAX_WAIT = NS
#: Maximum number of scans that wait for odometry, and of odometry poses that are stored.
MAX_WAITING, MAX_POSES = 2000, 10_000


@dataclass(frozen=True, slots=True, eq=False)
class StampedScan:
    """A scan with its time and the pose of the laser."""

    stamp: int  #: time of the first beam [ns]
    scan: LaserScan
    mount: Array  #: (3,) array, pose of the laser in the base frame [m, m, rad]


class Detector:
    """
    Finds the landmarks of one robot.

    A scan waits until odometry has passed its end, so that the result depends on stamps only. It
    is corrected for the motion between its beams.

    Parameters
    ----------
    detect : finds landmarks in a single scan
    min_beams : minimum number of beams that meet a landmark
    static_time : time [s] for which a landmark must have been seen at one place, also by fewer
        beams; 0 for no such test

    Attributes
    ----------
    rejected : number of rejected segments of all scans by reason
    scans, without_odometry, lost : number of scans, of those without odometry, which are neither
        corrected nor tested for what moves, and of those that are lost since too many waited

    """

    def __init__(self, detect: ScanDetector, min_beams: int, static_time: float) -> None:
        self._detect = detect
        self._min_beams = min_beams
        self._static = StaticFilter(round(static_time * NS)) if static_time > 0.0 else None
        self._stamps: list[int] = []
        self._poses: list[Array] = []
        self._waiting: deque[StampedScan] = deque()
        self._newest_scan: int | None = None
        self.rejected: Counter[RejectedSegment] = Counter()
        self.scans = self.without_odometry = self.lost = 0

    def add_odometry(self, stamp: int, pose: Array) -> None:
        """Add an odometry pose (3,); one that is not newer than all before is ignored."""
        if self._stamps and stamp <= self._stamps[-1]:
            return
        self._stamps.append(stamp)
        self._poses.append(pose)
        if len(self._stamps) > MAX_POSES:
            del self._stamps[:MAX_POSES // 2], self._poses[:MAX_POSES // 2]

    def add_scan(self, scan: StampedScan) -> bool:
        """Add a scan; return whether it is newer than all before, as it must be."""
        if self._newest_scan is not None and scan.stamp <= self._newest_scan:
            return False
        self._newest_scan = scan.stamp
        self._waiting.append(scan)
        if len(self._waiting) > MAX_WAITING:
            self._waiting.popleft()
            self.lost += 1
        return True

    def take(self) -> Iterator[tuple[StampedScan, Detections]]:
        """Yield the scans that wait for no more odometry, with their landmarks."""
        while self._waiting and self._is_ready(self._waiting[0]):
            yield self._processed(self._waiting.popleft())

    def close(self) -> Iterator[tuple[StampedScan, Detections]]:
        """Yield the last scans at the end of the input."""
        while self._waiting:
            yield self._processed(self._waiting.popleft())

    def _is_ready(self, scan: StampedScan) -> bool:
        newest = self._stamps[-1] if self._stamps else None
        if newest is not None and newest >= scan.stamp + scan.scan.duration:
            return True
        return self._newest_scan is not None and self._newest_scan - scan.stamp > MAX_WAIT

    def _processed(self, scan: StampedScan) -> tuple[StampedScan, Detections]:
        self.scans += 1
        begin, end = self._pose(scan.stamp), self._pose(scan.stamp + scan.scan.duration)
        if begin is None or end is None:
            self.without_odometry += 1
            found = self._detect(scan.scan)
            found = found.select(found.is_certain, RejectedSegment.OCCLUDED)
        else:
            laser = compose(begin, scan.mount)
            found = self._corrected(scan, between(laser, compose(end, scan.mount)))
            found = self._without_uncertain(scan.stamp, laser, found)
        found = found.select(found.counts >= self._min_beams, RejectedSegment.FEW_BEAMS)
        self.rejected += found.rejected
        return scan, found

    def _without_uncertain(self, stamp: int, laser: Array, found: Detections) -> Detections:
        """Return what is certainly a landmark, and static, for a pose (3,) of the laser."""
        if self._static is None:
            return found.select(found.is_certain, RejectedSegment.OCCLUDED)
        C = rotation(laser[2])
        is_static = self._static.are_static(
            stamp, transform(laser, found.points), C @ found.R @ C.T, found.is_certain, laser[:2])
        seen = found.select(is_static | found.is_certain, RejectedSegment.OCCLUDED)
        return seen.select(
            is_static[is_static | found.is_certain], RejectedSegment.NOT_STATIC)

    def _corrected(self, of: StampedScan, u: Array) -> Detections:
        """Return the landmarks as seen at the stamp, for a motion u (3,) until the end."""
        if of.scan.duration == 0:
            return self._detect(of.scan)
        v, omega = u[:2] * NS / of.scan.duration, u[2] * NS / of.scan.duration
        step = of.scan.time_increment
        # A beam points where the heading at its own time turns it.
        found = self._detect(replace(
            of.scan, angle_increment=of.scan.angle_increment + omega * step))
        return replace(found, points=found.points + np.outer(found.beams * step, v))

    def _pose(self, stamp: int) -> Array | None:
        """Return the pose by odometry at a stamp, None if there is no odometry around it."""
        after = bisect_right(self._stamps, stamp)
        if after and self._stamps[after - 1] == stamp:
            return self._poses[after - 1]
        if after in (0, len(self._stamps)):
            return None
        first, last = self._stamps[after - 1], self._stamps[after]
        return interpolated(
            self._poses[after - 1], self._poses[after], (stamp - first) / (last - first))
