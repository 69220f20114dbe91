# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The EKF over the joint state of all robots and landmarks, section 2.2 of [Liu].

One step, in the paper's order: predict every robot that moved, start new landmarks from the
predicted poses, then one joint update with all observations of known landmarks, and of robots.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, WHOLE_MAP
from fej_slam_ros.core.ekf.covariance import Correction, SparseRows
from fej_slam_ros.core.ekf.gating import (
    Association, Gate, GatedObservation, scan_gate_statistics, ScanGateStatistics)
from fej_slam_ros.core.ekf.linearization import Linearization, transport_errors
from fej_slam_ros.core.ekf.state import JointState, Landmark, ObservationColumns, Robot
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import (
    LandmarkKey, Motion, Observation, RendezvousKey, RobotObservation, RobotScan, Scan)

#: What is one is known to be one to this variance [m^2].
MERGE_VARIANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Innovation:
    """
    What one update made of the observations.

    Attributes
    ----------
    used : the observations of the update, in its order
    y : (2 m,) array, their innovation whitened in this order: unit normal where all is consistent
    gated : observations that were refused
    relaxed : observations that were used although the gate would refuse them, with more noise
    log_det : log det S

    """

    used: Sequence[Association]
    y: Array
    gated: Sequence[GatedObservation]
    inflated: Sequence[GatedObservation]
    log_det: float = 0.0

    def scan_gate_statistics(self) -> dict[str, ScanGateStatistics]:
        """Return how the scan of each robot was found by the gate."""
        return scan_gate_statistics(self.used, self.gated, self.inflated)

    def log_likelihood(self) -> float:
        """Return -1/2 (r^T S^-1 r + log det S), the log-likelihood but for a constant."""
        return -0.5 * (float(self.y @ self.y) + self.log_det)

    def nis(self) -> dict[str, list[float]]:
        """Return y^T y of each observation, for each robot that saw something."""
        values: dict[str, list[float]] = {}
        squares = np.square(self.y.reshape(-1, 2)).sum(axis=1).tolist()
        for association, square in zip(self.used, squares):
            values.setdefault(association.robot.name, []).append(square)
        return values


NO_INNOVATION = Innovation((), np.empty(0), (), ())


@dataclass(frozen=True, slots=True, eq=False)
class StackedObservations:
    """
    The m observations of an update.

    Attributes
    ----------
    sighted : who saw, and what
    z, R : (m, 2) and (m, 2, 2) arrays, what was measured, and its noise

    """

    sighted: ObservationColumns
    z: Array
    R: Array


class Filter:
    """
    An EKF whose kind is the linearisation policy that it is given.

    Parameters
    ----------
    state : the joint state that it estimates
    linearization : where its Jacobians are evaluated
    gate : which observations it believes
    shared_ids : whether one number is one landmark for all robots
    iterations : how many Gauss-Newton iterations an update takes; 1 is the EKF of the paper
    regions : whether it is compressed to a region, and to which

    """

    def __init__(
        self, state: JointState, linearization: Linearization, gate: Gate,
        shared_ids: bool = True, iterations: int = 1, regions: ActiveSubmap = WHOLE_MAP,
    ) -> None:
        self.state = state
        self.linearization = linearization
        self.gate = gate
        self._shared_ids = shared_ids
        self._iterations = iterations
        self.regions = regions

    def step(
        self, motions: Iterable[Motion], scans: Sequence[Scan],
        robot_scans: Iterable[RobotScan] = (),
    ) -> Innovation:
        """Predict, start landmarks, update: everything that happened at one stamp."""
        for motion in motions:
            self.predict(motion)
        return self.update([*self.start_landmarks(scans), *self.seen_robots(robot_scans)])

    def predict(self, motion: Motion) -> None:
        """Move one robot to the end of its motion, eqs. (2) to (6)."""
        robot = self.state.robots[motion.robot]
        x = self.state.estimate(robot)
        x_pred = models.f(x, motion.u)
        Phi = models.Phi(self.linearization.displacement(self.state, robot, x_pred, motion.stamp))
        G = models.G(x[2])
        self.state.covariance.propagate(robot.slot, Phi, G.dot(motion.Q).dot(G.T))
        self.state.move(robot, motion.stamp, x_pred)

    def start_landmarks(self, scans: Iterable[Scan]) -> list[Association]:
        """
        Start what is seen for the first time; return the observations that are left for the update.

        A landmark is started by the first robot that sees it, and that observation is used up. What
        another robot sees of the same new landmark joins this step's update.

        """
        left = []
        for scan in scans:
            robot = self.state.robots[scan.robot]
            for observation in scan.observations:
                key = self.landmark_key(scan.robot, observation.id)
                if key in self.state.landmarks:
                    left.append(Association(robot, self.state.landmarks[key], observation))
                else:
                    self._start_landmark(robot, key, observation)
        return left

    def start_place(self, key: RendezvousKey, observation: RobotObservation) -> None:
        """Start the place where a robot of another frame is seen."""
        robot = self.state.robots[key.observer]
        self.state.augment_place(key, robot, *self._first_seen(robot, key, observation))

    def seen_robots(self, scans: Iterable[RobotScan]) -> list[Association]:
        """Return what robots of this state saw of each other."""
        robots = self.state.robots
        return [
            Association(robots[scan.robot], robots[observation.seen], observation)
            for scan in scans for observation in scan.observations
            if {scan.robot, observation.seen} <= robots.keys()]

    def update(self, seen: Sequence[Association]) -> Innovation:
        """Correct all robots and landmarks by one joint update, eqs. (7) to (11)."""
        if not seen:
            return NO_INNOVATION
        looked = self._stacked(seen)
        self.regions.ensure_contains(self.state, looked.sighted.columns)
        r = self._innovation(looked)
        prior = self.state.covariance.project(self._H(looked), looked.R)
        sifted = self.gate.apply(seen, r, prior.S)
        if sifted.gated or sifted.inflated:
            rest = self.update(sifted.accepted)
            return Innovation(
                rest.used, rest.y, [*sifted.gated, *rest.gated], [*sifted.inflated, *rest.inflated],
                rest.log_det)
        correction = self.state.covariance.correction(prior, r.ravel())
        self._correct(looked, correction)
        return Innovation(seen, correction.y, (), (), correction.log_det)

    def merge(self, landmark: Landmark, other: Landmark) -> None:
        """Let two landmarks be one: condition on their difference being zero."""
        state = self.state
        columns = state.positions([landmark, other]).reshape(1, 4)
        self.regions.ensure_contains(state, columns)
        H = SparseRows(columns, np.hstack([np.eye(2), -np.eye(2)])[None])
        prior = state.covariance.project(H, MERGE_VARIANCE * np.eye(2)[None])
        difference = state.estimate(other) - state.estimate(landmark)
        self._apply(state.x_hat, state.covariance.correction(prior, difference))
        state.remove(other)

    def landmark_key(self, robot: str, number: int) -> LandmarkKey:
        """Return the identity of the landmark that a robot knows by a number."""
        return ('' if self._shared_ids or number < 0 else robot, number)

    def _start_landmark(self, robot: Robot, key: LandmarkKey, observation: Observation) -> None:
        self.state.augment(key, robot, *self._first_seen(robot, key, observation))

    def _first_seen(
        self, robot: Robot, key: LandmarkKey | RendezvousKey, observation: Observation | RobotObservation
    ) -> tuple[Array, Array, Array]:
        """Return a point (2,) that a robot sees first, F (2, 3) and the noise N (2, 2)."""
        x = self.state.estimate(robot)
        G = models.G(x[2])[:2, :2]
        point = x[:2] + G @ observation.z
        F = models.F(self.linearization.offset(self.state, robot, key, point))
        return point, F, G @ observation.R @ G.T

    def _correct(self, looked: StackedObservations, correction: Correction) -> None:
        """Apply the first correction of the prior, or the last of the Gauss-Newton iterations."""
        x_prior = self.state.x_hat
        for _ in range(self._iterations - 1):
            self.state.x_hat = self.linearization.retract(self.state, x_prior, correction.dx)
            correction = self._relinearized(looked, x_prior, correction.dx)
        self._apply(x_prior, correction)

    def _apply(self, x_prior: Array, correction: Correction) -> None:
        """Let estimate and covariance know of a correction of the prior."""
        self.state.x_hat = self.linearization.retract(self.state, x_prior, correction.dx)
        self.state.covariance.condition(correction)
        transport_errors(self.linearization, self.state, x_prior)

    def _relinearized(self, looked: StackedObservations, x_prior: Array, dx: Array) -> Correction:
        """
        Return the correction of the prior by the observations linearised at x_hat, to where dx led.

        An error of the prior reaches x_hat as A times it, so that there it is seen by H A.

        """
        H = self._H(looked)
        transport = self.linearization.transport(self.state, x_prior)
        if transport is not None:
            H = H.after(transport)
        r = self._innovation(looked).ravel() + H.of(dx)
        return self.state.covariance.correction(
            self.state.covariance.project(H, looked.R), r)

    def _stacked(self, seen: Sequence[Association]) -> StackedObservations:
        return StackedObservations(
            self.state.sighted([a.robot for a in seen], [a.seen for a in seen]),
            np.array([a.observation.z for a in seen]), np.array([a.observation.R for a in seen]))

    def _innovation(self, looked: StackedObservations) -> Array:
        """Return z - h (m, 2), always at the current estimate."""
        x = self.state.estimates_of(looked.sighted.columns)
        innovation: Array = looked.z - models.h(x[:, :3], x[:, 3:])
        return innovation

    def _H(self, looked: StackedObservations) -> SparseRows:
        """Return the Jacobian of the observations at the points of the policy, eqs. (10), (11)."""
        points = self.linearization.observation_points(self.state, looked.sighted)
        return SparseRows(looked.sighted.columns, models.H(*points))
