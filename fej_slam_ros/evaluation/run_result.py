# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The result of a run, and its poses matched with ground truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.ground_truth import RecordedTruth


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedTrajectory:
    """Estimated poses of one robot in one frame."""

    stamps: NDArray[np.int64]  #: (n,) array, ascending [ns]
    #: poses, P: (n, 3) and (n, 3, 3) arrays, estimates and their covariances
    poses: Array
    P: Array
    frame: str  #: ``map``, or the robot's own frame if it never joined the map
    steps: int  #: number of estimated poses in all frames


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkMap:
    """Landmarks in ``map``: IDs (n,), points (n, 2) and covariances P (n, 2, 2)."""

    ids: NDArray[np.int64]
    points: Array
    P: Array


@dataclass(frozen=True, slots=True)
class NisSum:
    """Sum of a robot's normalised innovations squared, and its degrees of freedom."""

    total: float
    dof: int


@dataclass(frozen=True, slots=True, eq=False)
class RunResult:
    """Result of a run."""

    trajectories: Mapping[str, EstimatedTrajectory]  #: of each robot
    landmarks: LandmarkMap  #: the map
    nis: Mapping[str, NisSum]  #: of each robot for which the run reports it
    shared_ids: bool = True  #: whether landmark IDs are those of the ground truth
    invalid_messages: int = 0  #: number of recorded messages that are left out


@dataclass(frozen=True, slots=True, eq=False)
class MatchedPoses:
    """Estimated poses of one robot, each with the true pose at its stamp."""

    stamps: NDArray[np.int64]  #: (n,) array [ns]
    #: poses, P: (n, 3) and (n, 3, 3) arrays, estimates and their covariances
    poses: Array
    P: Array
    true: Array  #: (n, 3) array, true poses in ``map``
    frame: str  #: frame of the estimates

    @property
    def in_map(self) -> bool:
        """Return whether estimates and true poses share a frame."""
        return self.frame == MAP


def match(robot: str, trajectory: EstimatedTrajectory, truth: RecordedTruth) -> MatchedPoses:
    """Return the poses of a robot at the stamps that its ground truth covers."""
    stamps = trajectory.stamps.tolist()
    covered = np.array([truth.covers(robot, stamp) for stamp in stamps], dtype=bool)
    true = [truth.pose(robot, stamp) for stamp in trajectory.stamps[covered].tolist()]
    return MatchedPoses(
        trajectory.stamps[covered], trajectory.poses[covered], trajectory.P[covered],
        np.array(true).reshape(-1, 3), trajectory.frame)
