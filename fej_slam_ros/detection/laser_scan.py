# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of planar lasers, and their beams in one form whatever the driver."""

from dataclasses import dataclass, replace
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Indices
from fej_slam_ros.core.records import NS

#: Ranges of beams with these meanings, as in REP 117 of ROS.
TOO_NEAR, NOTHING, UNKNOWN = -np.inf, np.inf, np.nan
#: Largest number of neighbouring beams without return that are dropouts.
MAX_DROPOUTS = 3
#: Smallest range that is used [m], also of lasers that state none.
MIN_RANGE = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class LaserScan:
    """A scan, in the frame of the laser; fields as of ``sensor_msgs/LaserScan``."""

    #: (n,) array [m]: TOO_NEAR, NOTHING and UNKNOWN as in REP 117; of values outside of the limits
    #: of the sensor, 0 and those above are NOTHING, others TOO_NEAR
    ranges: Array
    #: angle_min, angle_increment: of the first beam and between beams, negative if clockwise [rad]
    angle_min: float
    angle_increment: float
    time_increment: float  #: between beams [s], 0 if unknown
    #: range_min, range_max: limits of the sensor [m]
    range_min: float
    range_max: float
    intensities: Array | None = None  #: (n,) array, if the laser measures them
    #: whether the first beam follows the last one if the scan is a full turn; not for a robot that
    #: moves, which sees what is there from two places
    joins: bool = True

    @property
    def duration(self) -> int:
        """Return the time from the first to the last beam [ns]."""
        return round(self.time_increment * max(len(self.ranges) - 1, 0) * NS)

    def reversed(self) -> 'LaserScan':
        """Return the same scan with its last beam first, of a driver that turned it around."""
        return replace(
            self, ranges=self.ranges[::-1],
            angle_min=self.angle_min + self.angle_increment * (len(self.ranges) - 1),
            angle_increment=-self.angle_increment,
            intensities=None if self.intensities is None else self.intensities[::-1])


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The beams of a scan whose result is known, counterclockwise."""

    angles: Array  #: (k,) array, increasing [rad]
    ranges: Array  #: (k,) array [m], TOO_NEAR or NOTHING; never UNKNOWN
    index: Indices  #: (k,) array, number of each beam in the scan
    increment: float  #: angle between neighbouring beams of the scan, positive [rad]
    is_closed: bool  #: whether the last beam is beside the first one
    limit: float  #: range beyond which no beam has a return [m]

    def turned(self, begin: int) -> 'Beams':
        """Return a closed scan from another beam on."""
        turn = self.angles[-1] + self._seam() - self.angles[0]
        angles = np.append(self.angles[begin:], self.angles[:begin] + turn)
        return replace(
            self, angles=angles, ranges=np.roll(self.ranges, -begin),
            index=np.roll(self.index, -begin))

    def padded(self, before: float, after: float) -> 'Beams':
        """Return the beams with a neighbour of given range [m] at both ends."""
        ends = self.angles[[0, -1]] if len(self.angles) else np.zeros(2)
        gap = self._seam()
        return replace(
            self, angles=np.concatenate([[ends[0] - gap], self.angles, [ends[1] + gap]]),
            ranges=np.concatenate([[before], self.ranges, [after]]),
            index=np.concatenate([[-1], self.index, [-1]]))

    def _seam(self) -> float:
        """Return the angle from the last beam to the first one, or to what is beyond the scan."""
        if not self.is_closed or not len(self.angles):
            return self.increment
        return 2.0 * math.pi - float(self.angles[-1] - self.angles[0])


def beams_of(scan: LaserScan, max_range: float) -> Beams:
    """
    Return the known beams of a scan.

    Up to `MAX_DROPOUTS` beams without return between two with one are dropouts, hence unknown.
    Whatever is beyond `max_range` counts as nothing.

    """
    r, limit = np.array(scan.ranges, np.float64), min(scan.range_max, max_range)
    with np.errstate(invalid='ignore'):
        r[(r == 0.0) | (r >= limit)] = NOTHING
        r[r < max(scan.range_min, MIN_RANGE)] = TOO_NEAR
    index = np.arange(len(r))
    if scan.angle_increment < 0.0:
        r, index = r[::-1], index[::-1]
    increment = abs(scan.angle_increment)
    is_closed = scan.joins and increment * (len(r) + 0.5) >= 2.0 * np.pi
    known = ~(np.isnan(r) | _dropouts(r, is_closed))
    # The last beam may look where the first one does, and further ones of a laser that turns.
    known &= np.arange(len(r)) * increment < 2.0 * np.pi - increment / 2.0
    angles = scan.angle_min + scan.angle_increment * index[known].astype(np.float64)
    return Beams(angles, r[known], index[known], increment, is_closed, limit)


def _dropouts(r: Array, is_closed: bool) -> Flags:
    """Return which beams (n,) without return are few between others with one."""
    few = MAX_DROPOUTS
    near = np.pad(r, few, 'wrap') if is_closed else np.pad(r, few, constant_values=NOTHING)
    is_return = np.isfinite(near)
    n = len(r)
    dropouts = np.zeros(n, bool)
    for before in range(1, few + 1):
        for after in range(1, few + 2 - before):
            first, last = few - before, few + after
            dropouts |= is_return[first:first + n] & is_return[last:last + n]
    dropouts &= r == NOTHING
    return dropouts
