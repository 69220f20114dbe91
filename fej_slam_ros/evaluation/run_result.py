# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The result of a run, and its poses matched with ground truth."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, poses_at, Stamps
from fej_slam_ros.core.ground_truth import MAX_GAP, RecordedTruth


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedTrajectory:
    """Estimated poses of one robot in one frame."""

    stamps: Stamps  #: (n,) array, ascending [ns]
    #: poses, P: (n, 3) and (n, 3, 3) arrays, estimates and their covariances
    poses: Array
    P: Array
    frame: str  #: ``map``, or the robot's own frame if it never joined the map
    steps: int  #: number of estimated poses in all frames


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkMap:
    """Landmarks in one frame: IDs (n,), points (n, 2) and covariances P (n, 2, 2)."""

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

    stamps: Stamps  #: (n,) array [ns]
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
    """
    Return the poses of a robot at the stamps that its ground truth covers.

    Dense ground truth is interpolated at the stamps of the estimates. Where it is sparse, the
    estimates are interpolated at the stamps of the true poses.

    """
    known = trajectory.stamps
    covered = {stamp for stamp in known.tolist() if truth.covers(robot, stamp)}
    between = {stamp for stamp in truth.isolated(robot) if _is_between(stamp, known)}
    stamps = np.array(sorted(covered | between), dtype=np.int64)
    true = [truth.pose(robot, stamp) for stamp in stamps.tolist()]
    exact = np.searchsorted(known, stamps).clip(max=max(len(known) - 1, 0))
    poses, P = trajectory.poses[exact], trajectory.P[exact]
    # Estimates at their own stamps keep every bit.
    moved = known[exact] != stamps
    if moved.any():
        poses[moved] = poses_at(stamps[moved], known, trajectory.poses)
        begin, end = exact[moved] - 1, exact[moved]
        share = ((stamps[moved] - known[begin]) / (known[end] - known[begin]))[:, None, None]
        P[moved] = (1.0 - share) * trajectory.P[begin] + share * trajectory.P[end]
    return MatchedPoses(stamps, poses, P, np.array(true).reshape(-1, 3), trajectory.frame)


def _is_between(stamp: int, known: Stamps) -> bool:
    """Return whether a stamp is between two known ones that are close to each other."""
    after = int(np.searchsorted(known, stamp))
    return 0 < after < len(known) and bool(known[after] - known[after - 1] <= MAX_GAP)
