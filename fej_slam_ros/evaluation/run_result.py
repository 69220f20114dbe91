# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a run has estimated, what was true, and both where they can be compared."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, Flags, poses_at
from fej_slam_ros.core.ground_truth import MAX_GAP

Stamps = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class TrueTrajectory:
    """True poses (n, 3) of a robot in the frame ``map`` at stamps (n,) [ns], in their order."""

    stamps: Stamps
    poses: Array

    def covers(self, stamps: Stamps) -> Flags:
        """Return at which stamps (m,) the pose is known, or from shortly before to after."""
        after = np.searchsorted(self.stamps, stamps)
        inside = after < len(self.stamps)
        end = self.stamps[np.minimum(after, len(self.stamps) - 1)]
        begin = self.stamps[np.maximum(after - 1, 0)]
        covered: Flags = inside & ((end == stamps) | ((after > 0) & (end - begin <= MAX_GAP)))
        return covered

    def at(self, stamps: Stamps) -> Array:
        """Return the poses (m, 3) at covered stamps (m,), interpolated only between its own."""
        first = self.stamps[0]
        # Differences of stamps are exact as floats, stamps themselves are not.
        poses = poses_at(stamps - first, self.stamps - first, self.poses)
        place = np.searchsorted(self.stamps, stamps)
        known = self.stamps[place] == stamps
        poses[known] = self.poses[place[known]]
        return poses


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedTrajectory:
    """
    What was estimated of a robot, in one frame.

    Attributes
    ----------
    stamps : (n,) array, in their order [ns]
    poses, P : (n, 3) and (n, 3, 3) arrays, the estimates and their covariances
    frame : which these are in, ``map`` unless the robot never came there
    steps : how many poses were estimated of it, in whatever frame

    """

    stamps: Stamps
    poses: Array
    P: Array
    frame: str
    steps: int


@dataclass(frozen=True, slots=True, eq=False)
class Landmarks:
    """Landmarks in ``map``: ids (n,), points (n, 2) and covariances P (n, 2, 2)."""

    ids: NDArray[np.int64]
    points: Array
    P: Array


@dataclass(frozen=True, slots=True)
class Nis:
    """Normalised innovations squared of a robot: their sum, and its degrees of freedom."""

    total: float
    dof: int


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """
    What came of a run.

    Attributes
    ----------
    ways : of each robot
    landmarks : the map
    nis : of each robot, where the run tells it
    shared_ids : whether the numbers of landmarks are those of the world

    """

    ways: Mapping[str, EstimatedTrajectory]
    landmarks: Landmarks
    nis: Mapping[str, Nis]
    shared_ids: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """True ways of the robots, and true positions (2,) of landmarks by number."""

    ways: Mapping[str, TrueTrajectory]
    landmarks: Mapping[int, Array] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPoses:
    """
    A robot where it was estimated and the truth is known.

    Attributes
    ----------
    stamps : (n,) array [ns]
    poses, P : (n, 3) and (n, 3, 3) arrays, the estimates and their covariances
    true : (n, 3) array, the true poses
    frame : which the estimates are in

    """

    stamps: Stamps
    poses: Array
    P: Array
    true: Array
    frame: str

    @property
    def in_map(self) -> bool:
        """Return whether estimates and truth are of one frame."""
        return self.frame == MAP


def compared(way: EstimatedTrajectory, truth: TrueTrajectory) -> MatchedPoses:
    """Return a robot where its truth is known."""
    known = truth.covers(way.stamps)
    stamps = way.stamps[known]
    return MatchedPoses(stamps, way.poses[known], way.P[known], truth.at(stamps), way.frame)
