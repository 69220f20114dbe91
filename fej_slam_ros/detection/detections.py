# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Landmarks found in a scan, and the reasons why others were not."""

from collections import Counter
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Indices


class RejectedSegment(Enum):
    """Why neighbouring beams of a scan are not a landmark."""

    FEW_BEAMS = 'few_beams'  #: met by too few beams
    WIDE = 'wide'  #: wider than the largest post
    OCCLUDED = 'occluded'  #: beside something nearer, or at the edge or the range of the laser
    NOT_ROUND = 'not_round'  #: not the arc of a circle
    RADIUS = 'radius'  #: a circle outside of the limits of the radius
    NOT_STATIC = 'not_static'  #: not yet seen at one place for long enough, as a person who walks


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """m landmarks in a scan, in the frame of the laser."""

    #: points, R: (m, 2) and (m, 2, 2) arrays, centres [m] and their covariances
    points: Array
    R: Array
    radii: Array  #: (m,) array [m]
    beams: Indices  #: (m,) array, the beam of the scan through the middle of each
    counts: Indices  #: (m,) array, number of beams that met each
    #: (m,) array, whether it is certainly one; others may be the end of a wall, and are used where
    #: a landmark is known to be
    is_certain: Flags
    rejected: Counter[RejectedSegment]  #: number of rejected segments by reason
    #: (k, 2) array, places of other objects, which too few beams met [m]
    thin: Array = field(default_factory=lambda: np.empty((0, 2)))

    @classmethod
    def none(cls, rejected: Counter[RejectedSegment]) -> 'Detections':
        """Return no landmarks."""
        index = np.empty(0, np.intp)
        return cls(
            np.empty((0, 2)), np.empty((0, 2, 2)), np.empty(0), index, index,
            np.empty(0, np.bool_), rejected)

    def select(self, kept: Flags, reason: RejectedSegment) -> 'Detections':
        """Return some of the landmarks, with the others counted as rejected."""
        rejected = self.rejected + Counter({reason: int(np.count_nonzero(~kept))})
        return replace(
            self, points=self.points[kept], R=self.R[kept], radii=self.radii[kept],
            beams=self.beams[kept], counts=self.counts[kept], is_certain=self.is_certain[kept],
            rejected=rejected)
