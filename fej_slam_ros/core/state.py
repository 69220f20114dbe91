# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The joint state of robots and landmarks in one frame, eq. (1) of [Liu] for any number of robots.

Every variable has a slot; at its slot the joint state holds its estimate, its first estimate and
its covariance. Robots are independent between updates, so each is kept at a stamp of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.covariance import Covariance, Indices, Slot
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import LandmarkKey


@dataclass(slots=True, eq=False)
class Robot:
    """A robot's slot and the stamp [ns] that its pose is of."""

    name: str
    slot: Slot
    stamp: int


@dataclass(slots=True, eq=False)
class Landmark:
    """A landmark's slot and its owner, the robot that saw it first."""

    key: LandmarkKey
    slot: Slot
    owner: str


Variable = Robot | Landmark


class JointState:
    """
    Robots and landmarks in one frame.

    Attributes
    ----------
    robots, landmarks : the variables, in the order in which they came
    x_hat : (n,) array, the estimate
    x_first : (n,) array, the first estimate: of a landmark its value when it was started, of a
        robot its pose right after its own prediction to its present stamp
    covariance : the joint covariance of the estimate

    """

    def __init__(self) -> None:
        self.robots: dict[str, Robot] = {}
        self.landmarks: dict[LandmarkKey, Landmark] = {}
        self.x_hat: Array = np.empty(0)
        self.x_first: Array = np.empty(0)
        self.covariance = Covariance()

    def estimate(self, variable: Variable) -> Array:
        """Return a copy of the variable's estimate."""
        return self.x_hat[variable.slot.start:variable.slot.stop].copy()

    def first_estimate(self, variable: Variable) -> Array:
        """Return a copy of the variable's first estimate."""
        return self.x_first[variable.slot.start:variable.slot.stop].copy()

    def marginal(self, variables: Sequence[Variable]) -> Array:
        """Return the joint covariance of the variables."""
        return self.covariance.marginal([variable.slot for variable in variables])

    def indices(self, variables: Sequence[Variable]) -> Indices:
        """Return the slots of m variables of one size, (m, size)."""
        starts = np.array([variable.slot.start for variable in variables])
        return starts[:, None] + np.arange(variables[0].slot.size)

    def variables(self) -> list[Variable]:
        """Return everything in the order of the slots, which leave no gap."""
        return sorted(
            [*self.robots.values(), *self.landmarks.values()], key=lambda v: v.slot.start)

    def headings(self) -> Indices:
        """Return the slots of the robots' headings."""
        return np.array([robot.slot.start + 2 for robot in self.robots.values()], dtype=np.intp)

    @classmethod
    def of(
        cls, robots: Sequence[Robot], landmarks: Sequence[Landmark], x_hat: Array, x_first: Array,
        covariance: Covariance,
    ) -> 'JointState':
        """Return the state of variables whose slots in the covariance are given."""
        state = cls()
        state.robots = {robot.name: robot for robot in robots}
        state.landmarks = {landmark.key: landmark for landmark in landmarks}
        state.x_hat, state.x_first, state.covariance = x_hat, x_first, covariance
        return state

    def insert_robot(self, name: str, stamp: int, pose: Array, P: Array) -> Robot:
        """Add a robot whose pose is known with covariance P (3, 3), independent of all else."""
        robot = self.robots[name] = Robot(name, self.covariance.insert(P), stamp)
        self._append(pose)
        return robot

    def augment(
        self, key: LandmarkKey, owner: Robot, point: Array, F: Array, N: Array
    ) -> Landmark:
        """Add a landmark at point (2,) that depends on its owner's pose by F, with noise N."""
        slot = self.covariance.augment(owner.slot, F, N)
        landmark = self.landmarks[key] = Landmark(key, slot, owner.name)
        self._append(point)
        return landmark

    def move(self, robot: Robot, stamp: int, pose: Array) -> None:
        """Put a robot at its predicted pose, which is its first estimate at this stamp."""
        place = slice(robot.slot.start, robot.slot.stop)
        self.x_hat[place] = self.x_first[place] = pose
        robot.stamp = stamp

    def _append(self, value: Array) -> None:
        self.x_hat = np.append(self.x_hat, value)
        self.x_first = np.append(self.x_first, value)
