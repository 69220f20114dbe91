# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Errors and NEES of the poses of a run against ground truth that is known later."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.definiteness import are_definite
from fej_slam_ros.core.geometry import Array, pose_difference
from fej_slam_ros.core.ground_truth import RecordedTruth

#: Maximum number of estimates of a robot that wait for later ground truth; the oldest is dropped.
MAX_UNSCORED = 1000
#: Number of poses that are scored together.
SCORED_TOGETHER = 100


@dataclass(slots=True)
class PoseScore:
    """RMSE and NEES of one robot's poses against ground truth."""

    steps: int = 0  #: number of compared poses
    with_nees: int = 0  #: number of these with a definite covariance; an exact start has none
    latest_nees_per_dof: float | None = None  #: NEES/3 of the latest of these, None without any
    _position: float = 0.0
    _heading: float = 0.0
    _nees_per_dof: float = 0.0

    def add(self, errors: Array, P: Array) -> None:
        """Add pose errors (k, 3) in order of time, and the estimated covariances (k, 3, 3)."""
        self.steps += len(errors)
        for x, y, phi in errors.tolist():
            self._position += x * x + y * y
            self._heading += phi * phi
        definite = are_definite(P)
        values = nees_per_dof(errors[definite], P[definite]).tolist()
        self.with_nees += len(values)
        for value in values:
            self.latest_nees_per_dof = value
            self._nees_per_dof += value

    def position_rmse(self) -> float:
        """Return the root mean square position error [m] over the steps."""
        return float(np.sqrt(self._position / self.steps))

    def heading_rmse(self) -> float:
        """Return the root mean square heading error [rad] over the steps."""
        return float(np.sqrt(self._heading / self.steps))

    def mean_nees_per_dof(self) -> float | None:
        """Return the mean of NEES/3 over the steps; None without any definite covariance."""
        return self._nees_per_dof / self.with_nees if self.with_nees else None


class PoseEvaluation:
    """
    Errors of poses in ``map``, as soon as the ground truth at their stamps is known.

    Ground truth before the newest scored estimate of a robot is dropped.

    """

    def __init__(self, truth: RecordedTruth) -> None:
        self._truth = truth
        self._waiting: dict[str, deque[tuple[int, Array, Array]]] = {}
        self._scores: dict[str, PoseScore] = {}

    @property
    def scores(self) -> Mapping[str, PoseScore]:
        """Return the scores of the robots with ground truth, by name."""
        for robot in self._waiting:
            self._score(robot)
        return self._scores

    def add(self, robot: str, stamp: int, pose: Array, P: Array) -> None:
        """Add a pose (3,) and its P (3, 3); many are scored at once, in a fraction of the time."""
        waiting = self._waiting.setdefault(robot, deque(maxlen=MAX_UNSCORED))
        waiting.append((stamp, pose, P))
        if len(waiting) >= SCORED_TOGETHER:
            newest = self._truth.newest(robot)
            if newest is not None and waiting[SCORED_TOGETHER - 1][0] <= newest:
                self._score(robot)

    def pass_over(self, robot: str, stamp: int) -> None:
        """Drop the ground truth of a robot that is not in ``map`` before a stamp [ns]."""
        if robot in self._waiting:
            self._score(robot)
        if not self._waiting.get(robot):
            self._truth.forget_before(robot, stamp)

    def _score(self, robot: str) -> None:
        """Score the estimates of a robot up to its newest true pose."""
        waiting, newest = self._waiting[robot], self._truth.newest(robot)
        due: list[tuple[int, Array, Array]] = []
        while waiting and newest is not None and waiting[0][0] <= newest:
            due.append(waiting.popleft())
        if not due:
            return
        stamps, poses, P = zip(*due)
        known, true = self._truth.find_all(robot, stamps)
        if len(true):
            self._scores.setdefault(robot, PoseScore()).add(
                pose_difference(np.array(poses)[known], true), np.array(P)[known])
            self._truth.forget_before(robot, stamps[known[-1]])
