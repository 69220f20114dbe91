# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Round posts, trunks and poles in scans of a planar laser, by their shape."""

from collections import Counter
from dataclasses import dataclass, replace
import math

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_quantile
from fej_slam_ros.detection.circle_fit import fit_circles, line_chi_squares
from fej_slam_ros.detection.detections import Detections, RejectedSegment
from fej_slam_ros.detection.laser_scan import beams_of, LaserScan
from fej_slam_ros.detection.segments import segments

#: Fewest beams that determine a circle, together with its edges.
MIN_BEAMS = 3
#: Probability with which the residuals of a post pass, and number of standard deviations by which
#: its radius may be beyond the limits.
ROUND_PROBABILITY = 0.999
RADIUS_SIGMAS = 3.0
#: Ratio by which noise makes the chord between the outer beams longer than the largest post.
MAX_CHORD_RATIO = 1.2
#: Minimum difference of chi-square by which a circle fits better than a line, so that something of
#: which one edge is seen is certainly a post.
MIN_CURVATURE = 30.0


@dataclass(frozen=True, slots=True)
class PostDetector:
    """Detects posts."""

    #: Limits of the radius of a post [m].
    min_radius: float = 0.03
    max_radius: float = 0.5
    range_sigma: float = 0.03  #: Standard deviation of a range [m]
    max_range: float = math.inf  #: Range beyond which nothing is detected [m]

    def __call__(self, scan: LaserScan) -> Detections:
        """Return the posts in a scan."""
        sigma, rejected = self.range_sigma, Counter[RejectedSegment]()
        found = segments(beams_of(scan, self.max_range), self.max_radius, sigma)
        reason = np.full(len(found.first), None, object)
        reason[found.chords() > 2.0 * MAX_CHORD_RATIO * self.max_radius] = RejectedSegment.WIDE
        free = found.free_edges(sigma)
        reason[~free.any(axis=1)] = RejectedSegment.OCCLUDED
        reason[found.count < MIN_BEAMS] = RejectedSegment.FEW_BEAMS
        is_candidate = reason == None  # noqa: E711
        rejected.update(reason[~is_candidate])
        thin = found.select((found.count < MIN_BEAMS) & free.all(axis=1)).middles()
        if not is_candidate.any():
            return replace(Detections.none(rejected), thin=thin)
        found, free = found.select(is_candidate), free[is_candidate]
        circles = fit_circles(found, free, sigma, (self.min_radius, self.max_radius))
        points, R = circles.centres()
        middle = found.beams.index[found.first + found.count // 2]
        radii, slack = circles.x[:, 2], RADIUS_SIGMAS * np.sqrt(np.maximum(
            circles.P[:, 2, 2], 0.0))
        # Half a post beside something nearer is like the end of a wall.
        curvature = line_chi_squares(found, sigma) - circles.chi_square
        posts = Detections(
            points, R, radii, middle, found.count,
            free.all(axis=1) | (curvature > MIN_CURVATURE), rejected, thin)
        largest = [
            chi_square_quantile(max(int(n), 1), ROUND_PROBABILITY) for n in circles.dof]
        spacing = circles.x[:, 0] * found.beams.increment
        is_round = (circles.chi_square <= largest) & (circles.overhang <= spacing + slack)
        in_limits = (radii + slack >= self.min_radius) & (radii - slack <= self.max_radius)
        return posts.select(is_round, RejectedSegment.NOT_ROUND).select(
            in_limits[is_round], RejectedSegment.RADIUS)
