# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Linearisation policies: where the filter evaluates its Jacobians.

The policy is the only difference between the filters of section 3 of [Liu] and the invariant EKF.
It supplies the linearisation points, the retraction that applies a correction, and an optional
transport of the covariance after an update, for error coordinates that depend on the estimate.
"""

from collections.abc import Iterable, Mapping
from typing import ClassVar

import numpy as np

from fej_slam_ros.core.ekf import first_estimates
from fej_slam_ros.core.ekf.covariance import Transport
from fej_slam_ros.core.ekf.gating import Association
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot, Variable, Variables
from fej_slam_ros.core.geometry import Array, Indices, mean_rotation, perpendicular
from fej_slam_ros.core.ground_truth import Truth
from fej_slam_ros.core.records import (
    LandmarkKey, MAX_LINEAR_HEADING_SIGMA, PointKey, RendezvousKey)

Poses = dict[str, Array]
Points = dict[LandmarkKey, Array]
TwoArrays = tuple[Array, Array]

#: Standard deviation [rad] of a robot's heading change since it last took part in an update,
#: beyond which its landmarks no longer rotate with it.
MAX_HEADING_DRIFT = 0.01


class Linearization:
    """
    Interface between the filter and a policy; by default, Jacobians are taken at the estimate.

    Parameters
    ----------
    truth : ground truth, which is read only if `needs_truth`

    """

    needs_truth: ClassVar[bool] = False  #: whether it reads ground truth, which needs landmark IDs
    default_iterations: ClassVar[int] = 1  #: minimum of iterations; 1 is the EKF of the paper
    turns_points: ClassVar[bool] = False  #: whether a correction turns points with robots
    #: standard deviation [rad] of a robot's turn by odometry alone up to which it is linearised
    max_turn_sigma: ClassVar[float] = MAX_LINEAR_HEADING_SIGMA
    #: the same where it has to be corrected by observations without IDs, all at once
    max_turn_sigma_without_ids: ClassVar[float] = 0.1
    #: largest correction of a heading [rad] that needs no second iteration and renews no points
    max_correction: ClassVar[float] = np.inf

    def __init__(self, truth: Truth | None = None) -> None:
        """Construct the policy."""

    def motion_points(
        self, state: JointState, robot: Robot, x_pred: Array, stamp: int
    ) -> TwoArrays:
        """
        Return the poses (3,) between which Phi is taken, of a robot about to move to x_pred.

        By default x_{k|k} and x_{k+1|k}, eq. (5).

        """
        return self._value(state, robot), x_pred

    def offset(self, state: JointState, robot: Robot, key: PointKey, point: Array) -> Array:
        """
        Return b (2,) of F = [I, J b] for a variable initialized by the robot at point (2,).

        By default C(phi) z; the first estimate of the new variable is the point itself.

        """
        return point - self._value(state, robot)[:2]

    def observation_points(self, state: JointState, columns: Indices) -> Array:
        """
        Return the poses and points, (m, 5), at which m observations are linearised.

        Parameters
        ----------
        state : the joint state
        columns : (m, 5) array, the states that they depend on, as of `observation_columns`

        """
        return state.estimates_of(columns)

    def initialization_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """
        Return the points at which the step-0 covariance is linearised.

        By default the values of variables in the state, and the solution for new ones.

        Parameters
        ----------
        state : the state before step 0
        poses, points : the solution of eq. (12)
        stamp : time of step 0 [ns]

        """
        robots, landmarks = state.robots, state.landmarks
        known_poses = {name: self._value(state, robots[name]) for name in poses if name in robots}
        known = {key: self._value(state, landmarks[key]) for key in points if key in landmarks}
        return poses | known_poses, points | known

    def joining_points(
        self, state: JointState, shared: Variables, new: Variables, carried: Array, first: Array
    ) -> TwoArrays:
        """
        Return the points at which the joining of another frame is linearised.

        Parameters
        ----------
        state : the state that the other frame joins
        shared : variables of the state that are also in the other frame
        new : variables that are only in the other frame
        carried, first : (m,) arrays, the estimates and the first estimates of the new variables in
            the frame of the state

        Returns
        -------
        (k,), (m,) arrays
            Stacked values of the shared and of the new variables.

        """
        return np.concatenate([self._value(state, variable) for variable in shared]), carried

    def retract(self, state: JointState, x: Array, dx: Array) -> Array:
        """Return a joint estimate x (n,) corrected by dx (n,), with wrapped headings."""
        return KERNEL.retracted(x, dx, state.headings())

    def renew_points(self, state: JointState, columns: Indices) -> bool:
        """
        Renew points of linearisation that are far from the estimate; return whether any was.

        Parameters
        ----------
        state : the joint state before an update
        columns : (m, 5) array, the states of its observations, as of `observation_points`, of
            which some are not explained by linear errors

        """
        return False

    def corrects_far(self, turns: Array) -> bool:
        """Return whether any correction of the headings (N,) [rad] is above `max_correction`."""
        return bool((np.abs(turns) > self.max_correction).any())

    def renew_displaced_points(self, state: JointState) -> None:
        """Renew points of linearisation of a state of which a heading has been corrected far."""

    def of_joining_maps(self) -> 'Linearization':
        """Return the policy of robots in frames of their own, and of a state that a map joins."""
        return self

    def note_used(self, state: JointState, observations: Iterable[Association]) -> None:
        """Note which observations an update has used, if error coordinates depend on them."""

    def transport(self, state: JointState, x_prior: Array, dx: Array) -> Transport | None:
        """
        Return A that maps errors at x_prior (n,) to errors at x_hat; None for A = I.

        dx (n,) is the correction between them, with headings that are not wrapped.

        """
        return None

    def transport_errors(self, state: JointState, x_prior: Array, dx: Array) -> None:
        """Transform the covariance of errors at x_prior (n,) to that of errors at x_hat."""
        A = self.transport(state, x_prior, dx)
        if A is not None:
            state.covariance.transport(A)

    def _value(self, state: JointState, variable: Variable) -> Array:
        """Return the value at which a variable of the state is linearised."""
        return state.estimate(variable)


class Standard(Linearization):
    """The standard EKF: every Jacobian at the current estimate, eqs. (5), (10) and (11)."""

    def initialization_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """Return the solution, which is the current estimate after step 0."""
        return poses, points


class FirstEstimates(Linearization):
    """
    FEJ: every Jacobian at first estimates, eqs. (23), (24), so that rank(M) = 3N + 2n - 3.

    The displacement of Phi is x_{k+1|k} - x_{k|k-1}: a product of Phi is the Phi of the sum, so
    that no correction is left of the sum in eq. (16). H is evaluated at first estimates also for
    the observed robot of a robot-to-robot observation: the product of its Phi maps a rotation of
    the whole state to J p_{k|k-1}, which is in the null space only of H at p_{k|k-1}.

    """

    def observation_points(self, state: JointState, columns: Indices) -> Array:
        """Return the first estimates, eqs. (23) and (24)."""
        return state.x_first.take(columns)

    def joining_points(
        self, state: JointState, shared: Variables, new: Variables, carried: Array, first: Array
    ) -> TwoArrays:
        """Return the first estimates of shared and new variables."""
        return super().joining_points(state, shared, new, first, first)

    def renew_points(self, state: JointState, columns: Indices) -> bool:
        """Renew first estimates that have nothing to do with the estimates any more."""
        points = first_estimates.far_points(state, columns)
        first_estimates.renew(state, points)
        return len(points) > 0

    def of_joining_maps(self) -> Linearization:
        """Return FEJ with first estimates that are renewed where maps turn."""
        return RenewedFirstEstimates()

    def _value(self, state: JointState, variable: Variable) -> Array:
        return state.first_estimate(variable)


class RenewedFirstEstimates(FirstEstimates):
    """
    FEJ of maps that join, whose first estimates may be wrong by the turn of a map.

    Maps join at headings that later observations correct. An update that corrects a heading far
    is iterated once, and renews the first estimates of landmarks that are far from them by then.
    This is not in [Liu], where all robots start in one frame.

    """

    #: Of five robots behind walls, MRCLAM 6, NEES/3 is 1.4 at 0.1 and 1.9 at 0.2.
    max_correction = 0.1

    def renew_displaced_points(self, state: JointState) -> None:
        """Renew first estimates of landmarks that are far off."""
        first_estimates.renew(state, first_estimates.displaced_landmarks(state))


class Ideal(Linearization):
    """The ideal EKF: every Jacobian at the truth, eqs. (21) and (22). For simulations only."""

    needs_truth = True
    max_turn_sigma = np.inf

    def __init__(self, truth: Truth) -> None:
        self._truth = truth

    def motion_points(
        self, state: JointState, robot: Robot, x_pred: Array, stamp: int
    ) -> TwoArrays:
        """Return the true poses."""
        return self._value(state, robot), self._truth.pose(robot.name, stamp)

    def offset(self, state: JointState, robot: Robot, key: PointKey, point: Array) -> Array:
        """Return the true f - p."""
        return super().offset(state, robot, key, self._point(key))

    def observation_points(self, state: JointState, columns: Indices) -> Array:
        """Return the truth."""
        variables = {variable.slot.start: variable for variable in state.variables()}
        return np.array([
            np.concatenate([
                self._value(state, variables[pose]), self._value(state, variables[point])[:2]])
            for pose, point in columns[:, [0, 3]].tolist()])

    def initialization_points(
        self, state: JointState, poses: Poses, points: Points, stamp: int
    ) -> tuple[Poses, Points]:
        """Return the truth."""
        return (
            {name: self._truth.pose(name, stamp) for name in poses},
            {key: self._truth.landmark(key) for key in points})

    def joining_points(
        self, state: JointState, shared: Variables, new: Variables, carried: Array, first: Array
    ) -> TwoArrays:
        """Return the true values of shared and new variables."""
        true_new = np.concatenate(
            [np.empty(0), *(self._value(state, variable) for variable in new)])
        return super().joining_points(state, shared, new, true_new, first)

    def _value(self, state: JointState, variable: Variable) -> Array:
        if isinstance(variable, Robot):
            return self._truth.pose(variable.name, variable.stamp)
        return self._point(variable.key)

    def _point(self, key: PointKey) -> Array:
        if isinstance(key, RendezvousKey):
            return self._truth.rendezvous_point(key)
        return self._truth.landmark(key)


class Invariant(Linearization):
    """
    The EKF with right-invariant errors: unobservable directions independent of the estimate.

    The error of a robot is theta = phi - phi_hat and xi = p - p_hat - J p_hat theta; that of a
    landmark f is xi = f - f_hat - J f_hat theta with the theta of its owner, the first observer. A
    translation of the whole state adds the same to every xi; a rotation adds the same to every
    theta and leaves every xi unchanged. Both stay unobservable with every Jacobian at the current
    estimate.

    P is that of plain errors, so a prediction does not change landmarks, and the robot that a
    landmark rotates with may change at any update: once a robot's heading has drifted without
    observations, its error is no longer that of the landmarks it started (`note_used`). Phi, G, F
    and H are those of the standard EKF; only two parts differ: a correction is applied by the
    exponential map of each robot with its landmarks (`retract`), and as the update changes the
    estimate, so do the plain errors that correspond to an invariant error (`transport`).

    This filter is not in the papers; for one robot it is the invariant EKF of Barrau and Bonnabel,
    arXiv 1510.06263.

    """

    #: At high noise NEES/3 is 1.3 with three iterations and 2.4 with one.
    default_iterations = 3
    turns_points = True
    #: Errors of 1.4 rad are corrected at once; a standard deviation of 1 rad reaches half a turn.
    max_turn_sigma = max_turn_sigma_without_ids = 1.0

    def retract(self, state: JointState, x: Array, dx: Array) -> Array:
        """
        Return x with positions C(theta) p + V(theta) xi, xi = dp - J p theta: the exponential map.

        This is p + V(theta) dp; V(theta) is the mean of C over the angles from 0 to theta.

        """
        positions, owner, headings = state.heading_owners()
        turned = dx.copy()
        turned[positions] = mean_rotation(dx[headings], owner, dx[positions])
        return super().retract(state, x, turned)

    def note_used(self, state: JointState, observations: Iterable[Association]) -> None:
        """Let an observed landmark rotate with its observer if its own robot has drifted."""
        turned = {
            name for name, robot in state.robots.items()
            if robot.turn_variance > MAX_HEADING_DRIFT ** 2}
        for observer, observed, _ in observations if turned else ():
            if isinstance(observed, Landmark) and observed.rotation_owner in turned:
                state.set_rotation_owner(observed, observer)

    def transport(self, state: JointState, x_prior: Array, dx: Array) -> Transport:
        """Return A of equal theta and xi: dp becomes dp + J (p_hat - p_prior) theta."""
        positions, owner, headings = state.heading_owners()
        V, moved = np.zeros((len(x_prior), len(headings))), state.x_hat - x_prior
        V[positions, owner[:, None]] = perpendicular(moved[positions])
        return Transport(headings, V, dx, state.heading_of)


#: Factories of the policies by the value of parameter `filter`, given the ground truth.
LINEARIZATIONS: Mapping[str, type[Linearization]] = {
    'fej': FirstEstimates, 'invariant': Invariant, 'standard': Standard, 'ideal': Ideal}
