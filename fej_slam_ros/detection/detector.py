# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The detector of one robot: scans and odometry in, static landmarks out."""

from bisect import bisect_right
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import (
    Array, between, compose, perpendicular, pose_at, rotation, transform)
from fej_slam_ros.core.records import NS, Odometry
from fej_slam_ros.detection.detections import Detections, RejectedSegment
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.detection.static_filter import StaticFilter

#: Finds landmarks in a single scan.
ScanDetector = Callable[[LaserScan], Detections]

#: Time by which a later scan shows that odometry of the earlier one does not arrive, and longest
#: gap in the odometry across which it is interpolated [ns].
MAX_WAIT = NS
#: Motion [m, rad] during a scan up to which its first beam follows the last one.
MAX_MOTION = 0.003
#: Maximum number of scans that wait for odometry, and of odometry poses that are stored.
MAX_WAITING, MAX_POSES = 2000, 10_000
#: Maximum number of lasers of a robot whose scans may have the same stamps.
MAX_LASERS = 16


@dataclass(frozen=True, slots=True, eq=False)
class StampedScan:
    """A scan with its time and the pose of the laser."""

    stamp: int  #: time of the first beam [ns]
    scan: LaserScan
    mount: Array  #: (3,) array, pose of the laser in the base frame [m, m, rad]
    frame: str = ''  #: frame in which its landmarks are published, for the caller
    laser: str = ''  #: which of the lasers of the robot

    @property
    def end(self) -> int:
        """Return the time of the last beam [ns]."""
        return self.stamp + self.scan.duration


class _OdometryPose(NamedTuple):
    """A pose by odometry."""

    stamp: int  #: [ns]
    pose: Array  #: (3,) array [m, m, rad]
    Q: Array  #: (3, 3) covariance of the increment that leads to it


class Detector:
    """
    Finds the landmarks of one robot, which may have several lasers.

    A scan waits until odometry has passed its end, so that the result depends on stamps only. Its
    landmarks are those seen from the pose at its end: they are corrected for the motion between
    the beams.

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
        corrected nor tested for what moves, and of those that are lost since too many waited or
        time jumped
    late_odometry : number of odometry records that were not newer than all before
    restarts : number of jumps of time back by more than a second

    """

    def __init__(self, detect: ScanDetector, min_beams: int, static_time: float) -> None:
        self._detect = detect
        self._min_beams = min_beams
        self._static_time = round(static_time * NS)
        self._static = self._new_filter()
        self._odometry: list[_OdometryPose] = []
        self._waiting: deque[StampedScan] = deque()
        # Newest stamp of the scans of all lasers and of each one [ns].
        self._newest_scan: int | None = None
        self._newest_scans: dict[str, int] = {}
        self.rejected: Counter[RejectedSegment] = Counter()
        self.scans = self.without_odometry = self.lost = self.restarts = self.late_odometry = 0

    @property
    def waiting(self) -> int:
        """Return the number of scans that wait for odometry or for the processor."""
        return len(self._waiting)

    def add_odometry(self, record: Odometry) -> None:
        """Add odometry; a record that is not newer than all before is counted and ignored."""
        if self._odometry and self._odometry[-1].stamp - record.stamp > MAX_WAIT:
            self._restart()
        Q = np.zeros((3, 3))
        if self._odometry:
            before = self._odometry[-1].stamp
            if record.stamp <= before:
                self.late_odometry += 1
                return
            if record.twist_covariance is not None:
                Q = ((record.stamp - before) / NS) ** 2 * record.twist_covariance
        self._odometry.append(_OdometryPose(record.stamp, record.pose, Q))
        if len(self._odometry) > MAX_POSES:
            del self._odometry[:MAX_POSES // 2]

    def add_scan(self, scan: StampedScan) -> bool:
        """Add a scan; return whether it is newer than all of its laser, as it must be."""
        if self._newest_scan is not None and self._newest_scan - scan.stamp > MAX_WAIT:
            self._restart()
        is_listed = scan.laser in self._newest_scans or len(self._newest_scans) < MAX_LASERS
        newest = self._newest_scans.get(scan.laser) if is_listed else self._newest_scan
        if newest is not None and scan.stamp <= newest:
            return False
        if is_listed:
            self._newest_scans[scan.laser] = scan.stamp
        self._newest_scan = max(scan.stamp, self._newest_scan or scan.stamp)
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

    def _restart(self) -> None:
        """Forget all stamps: time has jumped back, or a stamp was far ahead."""
        self.restarts += 1
        self.lost += len(self._waiting)
        self._waiting.clear()
        self._newest_scan = None
        self._newest_scans.clear()
        self._odometry.clear()
        self._static = self._new_filter()

    def _new_filter(self) -> StaticFilter | None:
        return StaticFilter(self._static_time) if self._static_time > 0 else None

    def _is_ready(self, scan: StampedScan) -> bool:
        if self._odometry and self._odometry[-1].stamp >= scan.end:
            return True
        return self._newest_scan is not None and self._newest_scan - scan.stamp > MAX_WAIT

    def _processed(self, scan: StampedScan) -> tuple[StampedScan, Detections]:
        self.scans += 1
        begin, end = (
            pose_at(stamp, self._odometry, MAX_WAIT) for stamp in (scan.stamp, scan.end))
        if begin is None or end is None:
            self.without_odometry += 1
            found = self._detect(scan.scan)
            found = found.select(found.is_certain, RejectedSegment.OCCLUDED)
        else:
            laser = compose(end, scan.mount)
            u = between(laser, compose(begin, scan.mount))
            found = self._corrected(scan, u, self._covariance(scan.stamp, scan.end))
            found = self._without_uncertain(scan.end, laser, found)
        found = found.select(found.counts >= self._min_beams, RejectedSegment.FEW_BEAMS)
        self.rejected += found.rejected
        return scan, found

    def _without_uncertain(self, stamp: int, laser: Array, found: Detections) -> Detections:
        """Return what is certainly a landmark, and static, for a pose (3,) of the laser."""
        if self._static is None:
            return found.select(found.is_certain, RejectedSegment.OCCLUDED)
        C, points = rotation(laser[2]), transform(laser, found.points)
        is_static = self._static.are_static(
            stamp, points, C @ found.R @ C.T, found.is_certain, laser[:2])
        is_thin = self._static.are_thin(
            stamp, points, found.counts < self._min_beams, transform(laser, found.thin))
        is_seen = is_static | found.is_certain
        seen = found.select(is_seen, RejectedSegment.OCCLUDED)
        static = seen.select(is_static[is_seen], RejectedSegment.NOT_STATIC)
        return static.select(~is_thin[is_seen & is_static], RejectedSegment.FEW_BEAMS)

    def _corrected(self, stamped_scan: StampedScan, u: Array, Q: Array) -> Detections:
        """
        Return the landmarks as seen from the pose at the end of a scan.

        u (3,) is the motion that leads back from its end to its begin, Q (3, 3) its covariance.

        """
        scan, last = stamped_scan.scan, len(stamped_scan.scan.ranges) - 1
        if scan.duration == 0:
            return self._detect(scan)
        # A beam points where the heading at its own time turns it.
        found = self._detect(replace(
            scan, angle_min=scan.angle_min + u[2],
            angle_increment=scan.angle_increment - u[2] / last,
            joins=bool(np.abs(u).max() < MAX_MOTION)))
        share = 1.0 - found.beams / last
        points = found.points + np.outer(share, u[:2])
        # Q is that of the base, which turns about its own origin.
        C, of_base = rotation(stamped_scan.mount[2]), transform(stamped_scan.mount, points)
        of_shift = np.broadcast_to(np.eye(2), (len(points), 2, 2))
        J = C.T @ np.concatenate([of_shift, perpendicular(of_base)[:, :, None]], 2)
        R = found.R + share[:, None, None] * (J @ Q @ J.transpose(0, 2, 1))
        return replace(found, points=points, R=R)

    def _covariance(self, begin: int, end: int) -> Array:
        """Return the covariance (3, 3) of the motion between two stamps with a pose."""
        Q = np.zeros((3, 3))
        first = bisect_right(self._odometry, begin, key=attrgetter('stamp'))
        # A sum of all increments from the start would lose the small ones after a large one.
        for before, after in pairwise(self._odometry[first - 1:]):
            if before.stamp >= end:
                break
            inside = min(end, after.stamp) - max(begin, before.stamp)
            Q += inside / (after.stamp - before.stamp) * after.Q
        return Q
