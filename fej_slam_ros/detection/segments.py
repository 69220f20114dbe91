# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Segments of a scan: neighbouring beams that may have met one object, and what is beside them."""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Indices
from fej_slam_ros.detection.laser_scan import Beams, MAX_DROPOUTS, NOTHING, TOO_NEAR

#: Number of standard deviations of a range by which two on one object differ by noise.
JUMP_SIGMAS = 5.0 * 2.0**0.5
#: The same for an object and the range of the laser.
REACH_SIGMAS = 3.0
#: Largest angle between known beams on one object, and beside its edge, in increments.
MAX_BEAM_GAP = MAX_DROPOUTS + 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Segments:
    """m segments of the beams of a scan."""

    #: known beams, from the first of a segment on, with a neighbour at both ends
    beams: Beams
    #: first, count: (m,) arrays, first beam of each segment and number of its beams
    first: Indices
    count: Indices

    @property
    def last(self) -> Indices:
        """Return the last beam (m,) of each segment."""
        return self.first + self.count - 1

    def select(self, kept: Flags) -> 'Segments':
        """Return some of the segments."""
        return Segments(self.beams, self.first[kept], self.count[kept])

    def padded(self) -> tuple[Indices, Flags]:
        """Return the beams (m, n) of the segments, and which of these are not padding."""
        columns = np.arange(self.count.max(initial=0))
        is_beam = columns < self.count[:, None]
        return self.first[:, None] + np.where(is_beam, columns, 0), is_beam

    def chords(self) -> Array:
        """Return the lengths (m,) between the outer beams, at the nearer of both ranges [m]."""
        a, r = self.beams.angles, self.beams.ranges
        turn = a[self.last] - a[self.first]
        nearer = np.minimum(r[self.first], r[self.last])
        return 2.0 * nearer * np.sin(np.minimum(turn, np.pi) / 2.0)

    def middles(self) -> Array:
        """Return the points (m, 2) between the outer beams [m]."""
        outer = np.stack([self.first, self.last])
        a, r = self.beams.angles[outer].mean(axis=0), self.beams.ranges[outer].mean(axis=0)
        return np.stack([r * np.cos(a), r * np.sin(a)], 1)

    def free_edges(self, range_sigma: float) -> Flags:
        """
        Return whether both edges of the objects (m, 2) are seen.

        The beam beside an edge passes by: it reaches something farther away. Where it reaches
        nothing, the object must end before the range of the laser.

        """
        a, r, half = self.beams.angles, self.beams.ranges, self.chords() / 2.0
        free = np.empty((len(self.first), 2), bool)
        for k, (outer, beside) in enumerate(
                ((self.first, self.first - 1), (self.last, self.last + 1))):
            gap = np.abs(a[beside] - a[outer])
            reach = r[outer] + largest_jumps(r[outer] * gap, half, range_sigma, REACH_SIGMAS)
            is_within = (r[beside] < NOTHING) | (reach < self.beams.limit)
            free[:, k] = (
                (gap <= MAX_BEAM_GAP * self.beams.increment) & (r[beside] > r[outer]) & is_within)
        return free


def largest_jumps(
    width: Array, radius: Array | float, range_sigma: float, sigmas: float = JUMP_SIGMAS
) -> Array:
    """
    Return the largest differences of ranges [m] between beams at a distance [m] on one post.

    A beam that passes the centre of a circle at a distance b < rho meets it sqrt(rho^2 - b^2)
    before the nearest point to the centre, so that the range changes most beside an edge.

    """
    return sigmas * range_sigma + np.sqrt(2.0 * radius * width)


def segments(beams: Beams, max_radius: float, range_sigma: float) -> Segments:
    """
    Return the segments between jumps of the range.

    Parameters
    ----------
    beams : of one scan
    max_radius : largest radius of a post [m]
    range_sigma : standard deviation of a range [m]

    """
    def breaks(padded: Beams) -> Flags:
        """Return whether neighbouring beams (k,) have met different objects (k - 1,)."""
        finite, gap = np.isfinite(padded.ranges), np.diff(padded.angles)
        r = np.where(finite, padded.ranges, 0.0)
        is_one = finite[1:] & finite[:-1] & (gap <= MAX_BEAM_GAP * padded.increment)
        width = np.minimum(r[1:], r[:-1]) * gap
        differ: Flags = np.abs(np.diff(r)) > largest_jumps(width, max_radius, range_sigma)
        return differ | ~is_one

    if beams.is_closed and len(beams.ranges):
        begin = int(np.argmax(breaks(beams.padded(beams.ranges[-1], TOO_NEAR))))
        turned = beams.turned(begin)
        padded = turned.padded(turned.ranges[-1], turned.ranges[0])
    else:
        # What is beyond the field of view may be nearer.
        padded = beams.padded(TOO_NEAR, TOO_NEAR)
    inside, between = np.isfinite(padded.ranges), breaks(padded)
    inside[[0, -1]] = False
    firsts = np.flatnonzero(inside[1:] & (between | ~inside[:-1])) + 1
    ends = np.flatnonzero(inside[:-1] & (between | ~inside[1:])) + 1
    return Segments(padded, firsts, ends - firsts)
