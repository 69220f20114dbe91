# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearisation policies: where the filter's Jacobians are evaluated.

A policy is the only difference between the filters of section 3 of [Liu]. It supplies the points
to linearise at, the retraction that applies a correction, and an optional transport of the
covariance after an update, for error coordinates that depend on the estimate.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from fej_slam_ros.core.covariance import Indices
from fej_slam_ros.core.geometry import Array, wrap_all
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.state import JointState, Landmark, Robot, Variable
from fej_slam_ros.core.truth import Truth


Poses = dict[str, Array]
Points = dict[LandmarkKey, Array]


class Linearization(Protocol):
    """What the filter asks of a policy."""

    def displacement(self, state: JointState, robot: Robot, x_pred: Array, stamp: int) -> Array:
        """Return d (2,) of Phi = [I, J d; 0, 1] for a robot about to move to x_pred at stamp."""

    def offset(self, state: JointState, robot: Robot, key: LandmarkKey, point: Array) -> Array:
        """Return b (2,) of F = [I, J b] for a landmark that the robot starts at point (2,)."""

    def sighting_points(
        self, state: JointState, robots: Sequence[Robot], landmarks: Sequence[Landmark]
    ) -> tuple[Array, Array]:
        """Return the poses (m, 3) and points (m, 2) at which m sightings are linearised."""

    def start_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """
        Return where the step-0 covariance is linearised, given the solution of eq. (12).

        The state is that before step 0, with robots and landmarks known already.

        """

    def joining_points(
        self, state: JointState, shared: Sequence[Variable], new: Sequence[Variable],
        carried: Array,
    ) -> tuple[Array, Array]:
        """
        Return where the joining of another frame is linearised, both stacked.

        Parameters
        ----------
        state : the state that others join
        shared : variables of it that the others have, too
        new : variables of the others that it lacks
        carried : (m,) array, the estimates of these in the frame of the state

        """

    def retract(self, state: JointState, dx: Array) -> Array:
        """Return the joint estimate (n,) corrected by dx (n,)."""

    def transport(self, state: JointState, x_prior: Array) -> tuple[Indices, Array] | None:
        """Return (columns, V) of A = I + V E^T that carries P from x_prior to x_hat, or None."""


class Standard:
    """The standard EKF: every Jacobian at the current estimate, eqs. (5), (10) and (11)."""

    def displacement(self, state: JointState, robot: Robot, x_pred: Array, stamp: int) -> Array:
        """Return x_{k+1|k} - x_{k|k}, eq. (5)."""
        moved: Array = x_pred[:2] - state.estimate(robot)[:2]
        return moved

    def offset(self, state: JointState, robot: Robot, key: LandmarkKey, point: Array) -> Array:
        """Return C(phi) z."""
        away: Array = point - state.estimate(robot)[:2]
        return away

    def sighting_points(
        self, state: JointState, robots: Sequence[Robot], landmarks: Sequence[Landmark]
    ) -> tuple[Array, Array]:
        """Return the current estimates."""
        return state.x_hat[state.indices(robots)], state.x_hat[state.indices(landmarks)]

    def start_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """Return the solution itself."""
        return poses, points

    def joining_points(
        self, state: JointState, shared: Sequence[Variable], new: Sequence[Variable],
        carried: Array,
    ) -> tuple[Array, Array]:
        """Return the current estimates."""
        return np.concatenate([state.estimate(variable) for variable in shared]), carried

    def retract(self, state: JointState, dx: Array) -> Array:
        """Add, and wrap the headings."""
        x: Array = state.x_hat + dx
        headings = state.headings()
        x[headings] = wrap_all(x[headings])
        return x

    def transport(self, state: JointState, x_prior: Array) -> tuple[Indices, Array] | None:
        """Plain coordinates do not depend on the estimate."""
        return None


class FirstEstimates(Standard):
    """FEJ: every Jacobian at first estimates, eqs. (23), (24): then rank(M) = 3N + 2n - 3."""

    def displacement(self, state: JointState, robot: Robot, x_pred: Array, stamp: int) -> Array:
        """Return x_{k+1|k} - x_{k|k-1}: the steps telescope, whatever was corrected between."""
        moved: Array = x_pred[:2] - state.first_estimate(robot)[:2]
        return moved

    def sighting_points(
        self, state: JointState, robots: Sequence[Robot], landmarks: Sequence[Landmark]
    ) -> tuple[Array, Array]:
        """Return the first estimates."""
        return state.x_first[state.indices(robots)], state.x_first[state.indices(landmarks)]

    def start_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """Return first estimates of what was in the state before, else the solution."""
        robots, landmarks = state.robots, state.landmarks
        return (
            {n: state.first_estimate(robots[n]) if n in robots else x for n, x in poses.items()},
            {k: state.first_estimate(landmarks[k]) if k in landmarks else x
             for k, x in points.items()},
        )

    def joining_points(
        self, state: JointState, shared: Sequence[Variable], new: Sequence[Variable],
        carried: Array,
    ) -> tuple[Array, Array]:
        """Return the first estimates; of what is new that is the carried one."""
        return np.concatenate([state.first_estimate(variable) for variable in shared]), carried


class Ideal(Standard):
    """The ideal EKF: every Jacobian at the truth, eqs. (21) and (22). For simulations only."""

    def __init__(self, truth: Truth) -> None:
        self._truth = truth

    def displacement(self, state: JointState, robot: Robot, x_pred: Array, stamp: int) -> Array:
        """Return the true displacement."""
        p_k = self._truth.pose(robot.name, robot.stamp)
        p_k1 = self._truth.pose(robot.name, stamp)
        moved: Array = p_k1[:2] - p_k[:2]
        return moved

    def offset(self, state: JointState, robot: Robot, key: LandmarkKey, point: Array) -> Array:
        """Return the true f - p."""
        away: Array = self._truth.landmark(key) - self._truth.pose(robot.name, robot.stamp)[:2]
        return away

    def sighting_points(
        self, state: JointState, robots: Sequence[Robot], landmarks: Sequence[Landmark]
    ) -> tuple[Array, Array]:
        """Return the truth."""
        poses = [self._truth.pose(robot.name, robot.stamp) for robot in robots]
        points = [self._truth.landmark(landmark.key) for landmark in landmarks]
        return np.array(poses), np.array(points)

    def start_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """Return the truth."""
        return (
            {name: self._truth.pose(name, stamp) for name in poses},
            {key: self._truth.landmark(key) for key in points},
        )

    def joining_points(
        self, state: JointState, shared: Sequence[Variable], new: Sequence[Variable],
        carried: Array,
    ) -> tuple[Array, Array]:
        """Return the truth."""
        return (
            np.concatenate([self._of(variable) for variable in shared]),
            np.concatenate([np.empty(0), *(self._of(variable) for variable in new)]))

    def _of(self, variable: Variable) -> Array:
        if isinstance(variable, Robot):
            return self._truth.pose(variable.name, variable.stamp)
        return self._truth.landmark(variable.key)
