# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reflectors in scans of a planar laser, by their intensity."""

from collections import Counter
from dataclasses import dataclass
import math

import numpy as np

from fej_slam_ros.core.geometry import Flags, Indices
from fej_slam_ros.core.motion_models import polar
from fej_slam_ros.detection.detections import Detections, RejectedSegment
from fej_slam_ros.detection.laser_scan import Beams, beams_of, LaserScan, TOO_NEAR
from fej_slam_ros.detection.segments import largest_jumps, MAX_BEAM_GAP

#: Mean of sqrt(1 - b^2) over the offsets b of beams from the centre of a circle, and its variance.
MEAN_DEPTH, DEPTH_VARIANCE = math.pi / 4.0, 2.0 / 3.0 - math.pi**2 / 16.0
#: Radius of flat reflectors that are seen at an angle [m].
MIN_RADIUS = 0.1


@dataclass(frozen=True, slots=True)
class ReflectorDetector:
    """Detects runs of beams with a high intensity."""

    #: Minimum intensity of a beam that meets a reflector, in the sensor's unit.
    intensity_threshold: float
    radius: float = 0.0  #: Radius of round reflectors, 0 if they are flat [m]
    range_sigma: float = 0.03  #: Standard deviation of a range [m]
    max_range: float = math.inf  #: Range beyond which nothing is detected [m]

    def __call__(self, scan: LaserScan) -> Detections:
        """Return the reflectors in a scan, which must have intensities."""
        beams, bright = self._bright(scan)
        if not len(bright):
            return Detections.none(Counter())
        first, count = self._runs(beams, bright)
        is_seen = self._are_seen(beams, bright[first], bright[first + count - 1])
        rejected = Counter({RejectedSegment.OCCLUDED: int(np.count_nonzero(~is_seen))})
        if not is_seen.any():
            return Detections.none(rejected)
        first, count = first[is_seen], count[is_seen]
        runs = [bright[i:i + n] for i, n in zip(first, count)]
        D = np.array([beams.ranges[run].mean() for run in runs]) + MEAN_DEPTH * self.radius
        theta = np.array([beams.angles[run[[0, -1]]].mean() for run in runs])
        # The beams are spread evenly over the circle, so that the errors of their depths cancel.
        variance = self.range_sigma**2 / count + DEPTH_VARIANCE * (self.radius / count) ** 2
        # Each edge is anywhere between two beams.
        sigma_theta = beams.increment / math.sqrt(24.0)
        observed = [polar(*values, sigma_theta) for values in zip(D, theta, np.sqrt(variance))]
        return Detections(
            np.array([z for z, _ in observed]), np.array([R for _, R in observed]),
            np.full(len(D), self.radius),
            np.array([beams.index[run[len(run) // 2]] for run in runs]), count,
            np.ones(len(D), bool), rejected)

    def _bright(self, scan: LaserScan) -> tuple[Beams, Indices]:
        """Return the beams, turned so that no reflector is divided, and the bright ones."""
        if scan.intensities is None:
            raise ValueError('a scan without intensities')
        beams = beams_of(scan, self.max_range)
        is_bright = np.isfinite(beams.ranges)
        is_bright &= scan.intensities[beams.index] >= self.intensity_threshold
        if is_bright.all():
            return beams, np.empty(0, np.int64)
        if beams.is_closed:
            begin = int(np.argmin(is_bright))
            beams, is_bright = beams.turned(begin), np.roll(is_bright, -begin)
        return beams, np.flatnonzero(is_bright)

    def _runs(self, beams: Beams, bright: Indices) -> tuple[Indices, Indices]:
        """Return begin and length of each run of bright beams that meet one object."""
        a, r = beams.angles[bright], beams.ranges[bright]
        gaps, width = np.diff(a), np.minimum(r[1:], r[:-1]) * np.diff(a)
        jumps = largest_jumps(width, max(self.radius, MIN_RADIUS), self.range_sigma)
        is_new = (gaps > MAX_BEAM_GAP * beams.increment) | (np.abs(np.diff(r)) > jumps)
        first = np.flatnonzero(np.append(True, is_new))
        return first, np.diff(first, append=len(bright))

    def _are_seen(self, beams: Beams, first: Indices, last: Indices) -> Flags:
        """Return whether nothing nearer beside runs of beams may hide a part of a reflector."""
        padded = beams.padded(
            *((beams.ranges[-1], beams.ranges[0]) if beams.is_closed else (TOO_NEAR, TOO_NEAR)))
        slack = largest_jumps(np.zeros(1), 0.0, self.range_sigma)
        return (padded.ranges[first] > beams.ranges[first] - slack) & (
            padded.ranges[last + 2] > beams.ranges[last] - slack)
