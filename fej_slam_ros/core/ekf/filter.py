# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The EKF over the joint state of all robots and landmarks, section 2.2 of [Liu].

One step in the paper's order: predict every robot that moved, start new landmarks from the
predicted poses, then one joint update with all observations of known landmarks and of robots.
"""

from collections.abc import Iterable, Sequence
from functools import partial
from itertools import repeat
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap, WHOLE_MAP
from fej_slam_ros.core.ekf.covariance import SparseRows
from fej_slam_ros.core.ekf.curved_errors import curved_distances
from fej_slam_ros.core.ekf.gating import (
    Association, Gate, GatedObservation, GateResult, RobotAssociation, scan_gate_statistics,
    StatisticsByRobot)
from fej_slam_ros.core.ekf.joint_covariance import reserve
from fej_slam_ros.core.ekf.joint_update import joint_update, JointUpdate
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import (
    JointState, Landmark, observation_columns, position_indices, Robot, Variables)
from fej_slam_ros.core.geometry import Array, Indices, perpendicular
from fej_slam_ros.core.pieces import EndedError, pause
from fej_slam_ros.core.records import (
    AnyObservation, LandmarkKey, Motion, PointKey, RendezvousKey, RobotObservation, RobotScan,
    Scan)

#: Variance [m^2] of the pseudo-measurement that merges two landmarks; above 0 so that S stays
#: positive definite.
MERGE_VARIANCE = 1e-12
#: Distance [m] up to which a point has no direction.
MIN_DISTANCE = 1e-3


class Innovation(NamedTuple):
    """Result of one update."""

    used: Sequence[Association]  #: the observations of the update, in its order
    #: (2 m,) array, their whitened innovation in this order: standard normal if all is consistent
    y: Array
    rejected: Sequence[GatedObservation] = ()  #: observations that are not used, see GateResult
    #: observations that failed the gate and were used with inflated noise
    inflated: Sequence[GatedObservation] = ()
    log_det: float = 0.0  #: log det S
    interrupted: Sequence[Association] = ()  #: observations left out as the process is to end
    r: Array = np.empty(0)  #: (2 m,) array, the innovation
    #: (2 m, 2 m) array, its covariance, of which only the lower triangle counts; None if the
    #: update was in blocks
    S: Array | None = None

    def after(self, gated: GateResult) -> 'Innovation':
        """Return the result with the observations rejected and inflated before."""
        return self._replace(
            rejected=[*gated.rejected, *self.rejected],
            inflated=[*gated.inflated, *self.inflated])

    def scan_gate_statistics(self) -> StatisticsByRobot:
        """Return the gate's result on the landmarks of each robot's scan."""
        inflated = {gated.association for gated in self.inflated}
        failed = [bool(inflated) and a in inflated for a in self.used]
        return scan_gate_statistics([
            *zip(self.used, failed, failed),
            *((gated.association, gated.contradicts(), not gated.passed())
              for gated in self.rejected)])

    def log_likelihood(self) -> float:
        """Return -1/2 (r^T S^-1 r + log det S), the log-likelihood up to a constant."""
        return -0.5 * (float(self.y @ self.y) + self.log_det)

    def nis(self) -> dict[str, list[float]]:
        """Return y^T y of each observation, by observer."""
        values: dict[str, list[float]] = {}
        squares = np.square(self.y.reshape(-1, 2)).sum(axis=1).tolist()
        for association, square in zip(self.used, squares):
            values.setdefault(association.observer.name, []).append(square)
        return values


NO_INNOVATION = Innovation((), np.empty(0))


class StackedObservations(NamedTuple):
    """The m observations of an update."""

    columns: Indices  #: (m, 5) array, indices of the observer's pose and the observed position
    z: Array  #: (m, 2) array, the measurements
    R: Array  #: (m, 2, 2) array, their noise


def stacked(associations: Sequence[Association]) -> StackedObservations:
    """Return at least one observation as an update takes them."""
    observers, observed, observations = zip(*associations)
    return StackedObservations(*KERNEL.stacked(
        [robot.slot.start for robot in observers], [variable.slot.start for variable in observed],
        [observation.z for observation in observations],
        [observation.R for observation in observations]))


class Filter:
    """
    An EKF whose kind depends on its linearisation policy only.

    Parameters
    ----------
    state : the joint state that it estimates
    linearization : where its Jacobians are evaluated
    gate : which observations it accepts
    shared_ids : whether a landmark ID means the same landmark for all robots
    iterations : minimum number of Gauss-Newton iterations; 1 is the EKF of the paper
    submap : whether it works on an active submap, and on which

    """

    def __init__(
        self, state: JointState, linearization: Linearization, gate: Gate,
        shared_ids: bool = True, iterations: int = 1, submap: ActiveSubmap = WHOLE_MAP,
    ) -> None:
        self.state = state
        self.linearization = linearization
        self.gate = gate
        self._shared_ids = shared_ids
        self._iterations = iterations
        self.submap = submap

    def step(
        self, motions: Iterable[Motion], scans: Sequence[Scan],
        robot_scans: Iterable[RobotScan] = (),
    ) -> Innovation:
        """
        Predict, start landmarks and update with all input of one stamp.

        For a filter on its own; the estimator calls the parts, with step 0 and joining in between.

        """
        for motion in motions:
            self.predict(motion)
        return self.update([*self.start_landmarks(scans), *self.associate_robots(robot_scans)])

    def predict(self, motion: Motion) -> None:
        """Move one robot to the end of its motion, eqs. (2) to (6)."""
        robot = self.state.robots[motion.robot]
        x = self.state.pose(robot)
        x_pred, N = KERNEL.moved(x, motion.u, motion.Q)
        Phi = KERNEL.Phi(
            *self.linearization.motion_points(self.state, robot, x_pred, motion.stamp))
        self.state.covariance.propagate(robot.slot, Phi, N)
        self.state.move(robot, motion.stamp, x_pred)
        robot.turn_variance += float(motion.Q[2, 2])

    def update(self, observations: Sequence[Association]) -> Innovation:
        """
        Correct all robots and landmarks by one joint update, eqs. (7) to (11).

        The residual r is always taken at the current estimate, the Jacobian H at the points of the
        policy. S = L L^T, and K appears in factored form, K = W L^-1. If the gate rejects or
        inflates any observation, the update starts again with the accepted ones; r and the prior
        are unchanged, so these pass and the recursion ends. It also starts again, with all, where
        the policy has renewed points that were too far off. Iterations correct the same prior,
        whose covariance is updated once, by the last H. Where the policy renews points after a far
        correction, that is iterated, too.

        """
        if not observations:
            return NO_INNOVATION
        stack, state, policy = stacked(observations), self.state, self.linearization
        try:
            self.submap.ensure_contains(
                state, stack.columns, policy.turns_points, may_end=True)
        except EndedError:
            return NO_INNOVATION._replace(interrupted=observations)

        r = self._residual(stack)                                # 1. r = z - h(x), eq. (7)
        H = self._jacobian(stack.columns)                        # 2. H, eqs. (8) to (11)
        innovation = r.ravel()
        update = joint_update(                                   # 3. S = H P H^T + R
            state.covariance, H, stack.R, innovation)
        gated = self.gate.apply(                                 # 4. gate each by S_ii
            observations, r, update.own(), partial(self._curved_distances, r, stack.R, H))
        if not gated.is_linear() and policy.renew_points(state, stack.columns):
            return self.update(observations)                     # 1. to 4. at the new points
        if gated.rejected or gated.inflated:                     # 1. to 4. with the accepted ones
            return self.update(gated.accepted).after(gated)
        x_prior, S, corrections = state.x_hat, update.S, []
        is_far = self._corrects_far(update)
        iterations = max(self._iterations, gated.iterations, 2 if is_far else 1)
        for _ in range(iterations - 1):                          # Gauss-Newton: 1. to 5. again
            corrections.append(update.correction())
            if len(corrections[-1].y) < len(innovation):
                state.x_hat = x_prior
                return NO_INNOVATION._replace(interrupted=observations)
            update = self._relinearized(stack, x_prior, corrections[-1].dx)
        corrections.append(update.apply())                       # 5. K r, 6. P <- P - K S K^T
        self._correct(x_prior, corrections[-1].dx)               # 7. x <- x + K r
        if is_far:
            policy.renew_displaced_points(state)
        used = len(corrections[-1].y) // 2
        self._note_used(observations[:used])
        return Innovation(
            observations[:used], corrections[0].y[:2 * used], log_det=corrections[0].log_det,
            interrupted=observations[used:], r=innovation[:2 * used], S=S)

    def _curved_distances(self, r: Array, R: Array, H: SparseRows) -> Array:
        """Return the squared distances (m,) of innovations if errors lie on arcs."""
        return curved_distances(r, R, H.blocks, self.state.covariance.blocks(H.columns))

    def _note_used(self, observations: Sequence[Association]) -> None:
        """Note which robots an update has observed, or used observations of."""
        for observer, observed, _ in observations:
            observer.turn_variance = 0.0
            if isinstance(observed, Robot):
                observed.turn_variance = 0.0
        self.linearization.note_used(self.state, observations)

    def _corrects_far(self, update: JointUpdate) -> bool:
        """Return whether an update corrects a heading so far that points are to be renewed."""
        policy = self.linearization
        # Not asked without need: in blocks, the correction is computed again by the update.
        return policy.max_correction < np.inf and policy.corrects_far(
            update.correction().dx[self.state.headings()])

    def _correct(self, x_prior: Array, dx: Array) -> None:
        """Correct the prior estimate by dx (n,), whose covariance has been updated."""
        state, policy = self.state, self.linearization
        state.x_hat = policy.retract(state, x_prior, dx)
        policy.transport_errors(state, x_prior, dx)

    def _relinearized(
        self, stack: StackedObservations, x_prior: Array, dx: Array
    ) -> JointUpdate:
        """
        Return the update of the prior by observations linearised at the prior corrected by dx.

        An error e of the prior is A e at the corrected estimate: its Jacobian is H A.

        """
        state, policy = self.state, self.linearization
        state.x_hat = policy.retract(state, x_prior, dx)
        H = self._jacobian(stack.columns)
        A = policy.transport(state, x_prior, dx)
        if A is not None:
            H = H.after(A)
        return joint_update(
            state.covariance, H, stack.R, self._residual(stack).ravel() + H.of(dx))

    def _residual(self, stack: StackedObservations) -> Array:
        """Return z - h (m, 2) at the current estimate, whatever the policy."""
        return stack.z - KERNEL.h(self.state.estimates_of(stack.columns))

    def _jacobian(self, columns: Indices) -> SparseRows:
        """Return H of observations of states (m, 5) at the policy's points, eqs. (10), (11)."""
        points = self.linearization.observation_points(self.state, columns)
        return SparseRows(columns, KERNEL.H(points))

    def start_landmarks(self, scans: Iterable[Scan]) -> list[Association]:
        """
        Start unknown landmarks; return the associations of all other observations, for the update.

        The first observation of a landmark starts it and is used up; those of the same landmark by
        other robots take part in this step's update. No more are started once the process ends.

        """
        associations: list[Association] = []
        is_ended = False
        for scan in scans:
            robot, landmarks = self.state.robots[scan.robot], self.state.landmarks
            keys = self.keys_of(scan)
            new = {*keys}.difference(landmarks)
            if not new:
                associations += map(
                    Association, repeat(robot), map(landmarks.__getitem__, keys),
                    scan.observations)
                continue
            is_first = self.state.is_without_earlier_landmarks(robot.stamp)
            reserve(self.state.covariance, [2] * len(new))
            for key, observation in zip(keys, scan.observations):
                if key in landmarks:
                    associations.append(Association(robot, landmarks[key], observation))
                elif not is_ended:
                    self.state.augment(
                        key, robot, *self._start(robot, key, observation), is_first)
                    is_ended = pause()
        return associations

    def start_rendezvous_point(self, key: RendezvousKey, observation: RobotObservation) -> None:
        """Start the rendezvous point where a robot of another frame is observed."""
        robot = self.state.robots[key.observer]
        self.state.augment_rendezvous_point(key, robot, *self._start(robot, key, observation))

    def associate_robots(self, scans: Iterable[RobotScan]) -> list[RobotAssociation]:
        """Return the associations of observations between robots of this state."""
        robots = self.state.robots
        return [
            RobotAssociation(robots[scan.robot], robots[observation.observed], observation)
            for scan in scans for observation in scan.observations
            if {scan.robot, observation.observed} <= robots.keys()]

    def direction_sigmas(self, robot: Robot, observed: Variables) -> Array:
        """Return the standard deviations (m,) [rad] of the directions of points or robots."""
        columns = observation_columns([robot] * len(observed), observed)
        z = KERNEL.h(self.state.estimates_of(columns))
        distances = np.hypot(*z.T)
        # The Jacobian of a direction is that of z, times J z / |z|^2.
        rows = np.einsum('mi,mij->mj', perpendicular(z), self._jacobian(columns).blocks)
        across = np.sqrt(np.einsum(
            'mi,mij,mj->m', rows, self.state.covariance.blocks(columns), rows))
        sigmas = np.full(len(observed), np.inf)
        np.divide(across, distances ** 2, out=sigmas, where=distances > MIN_DISTANCE)
        return sigmas

    def landmark_difference(
        self, landmark: Landmark, other: Landmark
    ) -> tuple[Array, SparseRows]:
        """
        Return the difference (2,) of two landmarks and its Jacobian, for a state with robots.

        The Jacobian is that in the directions of the robot with the most certain heading. In those
        of the frame, the difference would turn with a rotation of everything, and reveal it.

        """
        state = self.state
        any_robot = next(iter(state.robots.values()))
        observed = observation_columns([any_robot, any_robot], [landmark, other])
        f, f_other = self.linearization.observation_points(state, observed)[:, 3:]
        H = np.hstack([np.eye(2), -np.eye(2), -perpendicular(f - f_other)[:, None]])
        columns = np.append(position_indices([landmark, other]), state.most_certain_heading())
        return state.estimate(landmark) - state.estimate(other), SparseRows(columns[None], H[None])

    def equate(self, landmark: Landmark, other: Landmark) -> None:
        """Update with the difference of two landmarks, zero: they are one."""
        state, (difference, H) = self.state, self.landmark_difference(landmark, other)
        # After a join, which leaves no submap, many landmarks may be duplicates.
        WHOLE_MAP.ensure_contains(state, H.columns, self.linearization.turns_points)
        update = joint_update(
            state.covariance, H, MERGE_VARIANCE * np.eye(2)[None], -difference)
        self._correct(state.x_hat, update.apply().dx)

    def keys_of(self, scan: Scan) -> list[LandmarkKey]:
        """Return the identities of the landmarks in a scan, one for each observation."""
        return self.landmark_keys(scan.robot, [s.id for s in scan.observations])

    def landmark_keys(self, robot: str, ids: Iterable[int]) -> list[LandmarkKey]:
        """Return the identities of the landmarks that a robot observes under some IDs."""
        owner = '' if self._shared_ids else robot
        return [('' if id_ < 0 else owner, id_) for id_ in ids]

    def _start(
        self, robot: Robot, key: PointKey, observation: AnyObservation
    ) -> tuple[Array, Array, Array]:
        """Return a new point (2,), its Jacobian F (2, 3) by the observer's pose, its noise."""
        x = self.state.pose(robot)
        G = models.G(x[2])[:2, :2]
        point = x[:2] + G.dot(observation.z)
        F = models.F(self.linearization.offset(self.state, robot, key, point))
        return point, F, G.dot(observation.R).dot(G.T)
