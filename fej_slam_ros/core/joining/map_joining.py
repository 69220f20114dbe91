# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joining a frame group L to another one T, e.g. the team; their filters have run separately so far.

The variables in both states determine the pose g = (t, alpha) of the frame of L in that of T: each
shared variable, x in T and x' in L, gives the condition x = g o x'. g has no prior, so three
combinations of the conditions determine g and the others correct both maps. The joined state must
contain no information about the global position and heading; that depends on the linearisation
points, which the policy chooses.
"""

from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag, cholesky, qr, solve_triangular

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.linearization import Linearization, transport_errors
from fej_slam_ros.core.ekf.state import at_slot, JointState, part_of
from fej_slam_ros.core.geometry import Array, poses_plus, wrap_all
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.change_of_frame import in_frame_of
from fej_slam_ros.core.joining.frame_fit import (
    determine_heading, fit, FrameFit, shared_variables, StackedVariables, Variables)
from fej_slam_ros.core.joining.outlying_landmarks import (
    outlying_landmarks, single_observation_failure)
from fej_slam_ros.core.joining.rendezvous_points import marginalize
from fej_slam_ros.core.pieces import EndedError, pause, PIECE_FLOPS, product, ranges
from fej_slam_ros.core.point_consensus import OUTLIER_D2
from fej_slam_ros.core.records import LandmarkKey


#: Factor on the largest standard deviation of the heading where the fit leaves out a landmark that
#: was observed once.
SINGLE_OBSERVATION_FACTOR = 2.0


class MapJoiner:
    """
    Joins the state of one filter to that of another if the shared variables allow it.

    Parameters
    ----------
    min_landmarks : minimum number of shared landmarks and rendezvous points
    probability : chi-square probability with which a correct join is accepted
    max_heading_sigma : largest standard deviation of the heading of g [rad]. Beyond it the
        first-order approximation fails for distant landmarks: 60 runs with 20 landmarks gave
        NEES/3 of 1.27 at 0.05, 1.31 at 0.1, 1.36 at 0.2 and 21 at 1

    """

    def __init__(
        self, min_landmarks: int, probability: float, max_heading_sigma: float = 0.1
    ) -> None:
        self._min_landmarks = min_landmarks
        self._tail = 1.0 - probability
        self._max_heading_sigma = max_heading_sigma

    def join(self, team: Filter, group: Filter) -> JoinFailure | None:
        """Join all variables of the group to the team; return the reason if that fails."""
        keys = team.state.landmarks.keys() & group.state.landmarks.keys()
        landmarks = len(keys)
        points = len(team.state.rendezvous_points.keys() & group.state.rendezvous_points.keys())
        shared = _counted(landmarks, 'shared landmark')
        if points:
            shared += f' and {_counted(points, "observation")} of robots'
        if landmarks + points < self._min_landmarks:
            return JoinFailure(f'{shared}, needs {self._min_landmarks}')
        # The conditions of a join cost little however large the maps are.
        ours, theirs = shared_variables(team.state, group.state)
        local = _from_first_robot(group, theirs)
        if not determine_heading(team.state, local):
            return JoinFailure(f'{shared} are at one place, which determines no heading')
        found = fit(team.state, local)
        failure = self._contradiction(team, ours, local, found, shared, landmarks + points)
        if failure is not None:
            return failure
        try:
            team.state = joined_state(
                team.state, _from_first_robot(group, group.state.variables()), found.pose,
                team.linearization)
        except EndedError:
            return JoinFailure('the process ended before it could join')
        for key in keys:
            team.state.landmarks[key].is_reobserved = True
        return None

    def misfits(self, team: Filter, group: Filter, most: int) -> Sequence[LandmarkKey]:
        """
        Return shared landmarks without which the others fit; none if these are more than `most`.

        One after the other, that without which chi-square is least.

        """
        _, theirs = shared_variables(team.state, group.state)
        local = _from_first_robot(group, theirs)
        left_out: list[LandmarkKey] = []
        while not (found := fit(team.state, local, left_out)).is_consistent(self._tail):
            if len(left_out) == most:
                return []
            left_out.append(found.worst_landmark())
        return left_out

    def _contradiction(
        self, team: Filter, ours: Variables, local: JointState, found: FrameFit, shared: str,
        count: int,
    ) -> JoinFailure | None:
        """Return why the fit of a number of shared variables, in words, joins no frames."""
        if not found.is_consistent(self._tail):
            outlying = outlying_landmarks(team.state, local, self._tail)
            if outlying and count - len(outlying) >= self._min_landmarks:
                return JoinFailure(
                    f'{len(outlying)} of {shared} contradict the others',
                    outlying_landmarks=outlying)
            worst, drop = found.worst_rendezvous_point()
            # The remaining ones must determine g.
            is_outlier = drop > OUTLIER_D2 and count > self._min_landmarks
            return JoinFailure(
                f'{shared} do not fit: chi-square {found.chi2:.1f}, limit'
                f' {found.limit(self._tail):.1f}', outlier=worst if is_outlier else None, d2=drop)
        sigma = found.heading_sigma()
        if sigma > self._max_heading_sigma:
            # The uncertainty of the global heading of the team is irrelevant.
            sigma = min(sigma, fit(_from_first_robot(team, ours), local).heading_sigma())
        if sigma > self._max_heading_sigma:
            return JoinFailure(
                f'{shared} determine the heading to {sigma:.2f} rad only, needs'
                f' {self._max_heading_sigma}')
        return single_observation_failure(
            team.state, local, SINGLE_OBSERVATION_FACTOR * self._max_heading_sigma)

    def apply_pose_prior(
        self, team: Filter, group: Filter, name: str, pose: Array, P: Array
    ) -> bool:
        """
        Add a robot of a group to the team by a pose prior; `join_via_robot` adds the rest.

        The prior is the robot's pose (3,) in the team's frame with covariance P (3, 3). Returns
        whether it fits the shared landmarks; otherwise the states are unchanged.

        """
        state = deepcopy(team.state)
        state.insert_robot(name, group.state.robots[name].stamp, pose, P)
        if self._accepted(state, group.state) is None:
            return False
        team.state = state
        return True

    def join_via_robot(self, team: Filter, group: Filter, name: str) -> bool:
        """
        Join a group to the team, whose state already contains one of its robots.

        The team's information on that robot must be independent of the group's. Returns whether
        the group has joined. If not, its map does not fit or the heading of the robot is too
        uncertain; the robot is then removed from the group, whose map may join later.

        """
        robot = group.state.robots[name]
        if group.state.variables() == [robot]:
            return True
        found = self._accepted(team.state, group.state)
        if found is not None and found.heading_sigma() <= self._max_heading_sigma:
            with suppress(EndedError):
                team.state = joined_state(
                    team.state, group.state, found.pose, team.linearization)
                return True
        group.state.remove(robot)
        return False

    def _accepted(self, team: JointState, group: JointState) -> FrameFit | None:
        """Return the fit of a group if it passes the chi-square test."""
        found = fit(team, group)
        return found if found.is_consistent(self._tail) else None


def _from_first_robot(filter_: Filter, variables: Variables) -> JointState:
    """
    Return some variables in the frame of the first robot, if any: the origin may be far away.

    The robot is added if it is not one of them.

    """
    robot = next(iter(filter_.state.robots.values()), None)
    if robot is None:
        return part_of(filter_.state, variables)
    part = part_of(filter_.state, variables if robot in variables else [robot, *variables])
    return in_frame_of(part, part.robots[robot.name], filter_.linearization)


def joined_state(
    team: JointState, group: JointState, g: Array, linearization: Linearization
) -> JointState:
    """
    Return the joint state of team and group in the team's frame, given the group's pose g (3,).

    Shared variables keep the team's slots and first estimates. The first estimate of a new
    variable is the group's estimate transformed by g; its dependence on g is linearised there.
    Neither state is changed.

    """
    ours, theirs = map(StackedVariables, shared_variables(team, group))
    new = StackedVariables([v for v in group.variables() if v not in theirs.variables])
    first = new.carried(g, group.estimates_of(new.indices))
    at, new_at = linearization.joining_points(team, ours.variables, new.variables, first)
    # The conditions are A dz - D dg = r, for z = [x_T, x_L] and A = [E_T, -C E_L], where E_T and
    # E_L select the shared variables and C turns them.
    x_carried = ours.carried(g, group.estimates_of(theirs.indices))
    r = ours.difference(x_carried, team.estimates_of(ours.indices))
    dz, dg, P_z, P_gz, P_g = _conditioned(
        *_prior(team, group, ours, theirs, g), ours.derivative(g, at), r)
    pause()

    # New variables are C x + D g of those of the group and of g.
    n = len(team.x_hat)
    in_z, D = n + new.indices, new.derivative(g, new_at)
    P_new = new.turned(g, P_z[in_z]) + D @ P_gz
    P_new_g = new.turned(g, P_gz[:, in_z].T) + D @ P_g
    own = new.turned(g, P_new[:, in_z].T) + D @ P_new_g.T
    x_new = (group.estimates() + dz[n:])[new.indices]
    g = poses_plus(g[None], dg)[0]
    x_hat = np.concatenate([team.estimates() + dz[:n], new.carried(g, x_new)])
    x_first = np.concatenate([team.x_first, first])
    pause()
    state = _combined(team, new.variables, x_hat, x_first, np.block([
        [P_z[:n, :n], P_new[:, :n].T], [P_new[:, :n], own]]))
    transport_errors(linearization, state, np.concatenate([team.estimates(), first]))
    # The rendezvous points of the two frames are no longer needed.
    marginalize(
        [key for key in team.rendezvous_points if key in group.rendezvous_points], [state])
    return state


def _prior(
    team: JointState, group: JointState, ours: StackedVariables, theirs: StackedVariables,
    g: Array,
) -> tuple[Array, Array, Array]:
    """Return the covariance P of z, A P and A P A^T."""
    P_T, P_L = team.marginal(team.variables()), group.marginal(group.variables())
    pause()
    P_LL = P_L[np.ix_(theirs.indices, theirs.indices)]
    APA = P_T[np.ix_(ours.indices, ours.indices)] + ours.turned_covariance(g, P_LL)
    AP = np.hstack([P_T[ours.indices], -ours.turned(g, P_L[theirs.indices])])
    return block_diag(P_T, P_L), AP, APA


def _conditioned(
    P: Array, AP: Array, APA: Array, D: Array, r: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """
    Return dz, dg, P_z, P_gz and P_g given A dz - D dg = r.

    z has had the covariance P, which becomes P_z. A itself is mostly zero: AP and APA are A P and
    A P A^T.

    """
    L = cholesky(APA, lower=True)
    pause()
    W = _solved(L, AP)
    B, y = (solve_triangular(L, x, lower=True) for x in (-D, r))
    # Rotated by Q^T, only the first three whitened conditions depend on g.
    Q, R = qr(B)
    pause()
    W, y = product(Q.T, W, may_end=True), Q.T @ y
    R_inverse = solve_triangular(R[:3], np.eye(3))
    P_gz = -R_inverse @ W[:3]
    P -= product(W[3:].T, W[3:], may_end=True)
    pause()
    return W[3:].T @ y[3:], R_inverse @ y[:3], P, P_gz, R_inverse @ R_inverse.T


def _solved(L: Array, A: Array) -> Array:
    """Return L^-1 A."""
    size = PIECE_FLOPS / len(L) ** 2
    if A.shape[1] <= size:
        return np.asarray(solve_triangular(L, A, lower=True), float)
    solved = np.empty(A.shape, order='F')
    for part in ranges(A.shape[1], size):
        solved[:, part] = solve_triangular(L, A[:, part], lower=True)
    return solved


def _combined(
    team: JointState, new: Variables, x_hat: Array, x_first: Array, P: Array
) -> JointState:
    """Return the state of the team's variables followed by the new ones."""
    covariance = Covariance()
    own = team.variables()
    slots = covariance.insert(P).split([v.slot.size for v in [*own, *new]])
    state = JointState([
        *(at_slot(variable, slot) for variable, slot in zip(own, slots)),
        # Evidence on landmarks of the other frame refers to positions in that.
        *(replace(variable, slot=slot) for variable, slot in zip(new, slots[len(own):]))],
        x_hat, x_first, covariance)
    headings = state.headings()
    state.x_hat[headings] = wrap_all(state.x_hat[headings])
    return state


def _counted(count: int, what: str) -> str:
    return f'{count} {what}' if count == 1 else f'{count} {what}s'
