# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence that a landmark was moved, or that a new one without ID exists."""

from dataclasses import dataclass, field

import numpy as np

from fej_slam_ros.core.geometry import Array

#: Consecutive rejected observations after which a landmark counts as moved, and the distance of an
#: observer from the first one [m]: from one position, a second landmark beside it has the same
#: effect.
MOVED_MIN_OBSERVATIONS = 10
MOVED_MIN_DISTANCE = 2.0


@dataclass(slots=True, eq=False)
class MovedLandmarkEvidence:
    """Evidence that a landmark was moved: its latest observations, all of which were rejected."""

    observations: int = 0  #: number of observations
    robots: set[str] = field(default_factory=set)  #: names of the observers
    first: Array | None = None  #: (2,) array, position of the first observer [m]
    distance: float = 0.0  #: of the farthest observer from it [m]

    def add(self, robot: str, position: Array) -> None:
        """Add an observation that failed the gate, from a position (2,)."""
        self.observations += 1
        self.robots.add(robot)
        if self.first is None:
            self.first = position
        self.distance = max(self.distance, float(np.linalg.norm(position - self.first)))

    def is_sufficient(self) -> bool:
        """Return whether there are enough observations, from distant poses or by two robots."""
        apart = self.distance >= MOVED_MIN_DISTANCE
        return self.observations >= MOVED_MIN_OBSERVATIONS and (apart or len(self.robots) > 1)


@dataclass(slots=True, eq=False)
class TentativeEvidence:
    """Evidence for a tentative landmark."""

    score: int = 0  #: number of scans that observed it again, less those that missed it
    #: consecutive scans without it, of its owner or, if that has left, of any robot
    unobserved: int = 0
