# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joining: robots that mapped in a frame of their own come into the frame of others.

What both have in their states ties the pose g = (t, alpha) of one frame in the other: each shared
variable x, in the other frame x', is a condition x = g o x'. Nobody knows anything of g before, so
three combinations of the conditions give g, and the others correct both maps. The joined state
must not know where everything is nor how it is turned; that depends on where the conditions are
linearised, which is up to the policy.
"""

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve, cholesky, qr, solve_triangular
from scipy.special import chdtri

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.linearization import Linearization, transport_errors
from fej_slam_ros.core.ekf.state import JointState, RendezvousPoint, Robot, Variable
from fej_slam_ros.core.geometry import (
    Array, between, compose, Indices, perpendicular, rigid_fit, rotation, transform, wrap,
    wrap_all)
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.change_of_frame import in_frame_of
from fej_slam_ros.core.joining.rendezvous import marginalize
from fej_slam_ros.core.records import RendezvousKey

#: Without a wrong place chi-square is less by this; by a right one in a million it is.
WRONG_FROM = float(chdtri(2, 1e-6))

#: The fit ends when g moves less than this [m, rad].
TOLERANCE = 1e-10
MAX_ITERATIONS = 50

Variables = Sequence[Variable]
POSE_SIZE = 3


@dataclass(frozen=True, slots=True, eq=False)
class FrameFit:
    """
    How one frame lies in another by what both share.

    Attributes
    ----------
    pose : (3,) array, g
    P : (3, 3) array, its covariance
    chi2, dof : weighted squared residual of the conditions, and its degrees of freedom
    shared : the variables of the conditions
    r : (k,) array, the residuals
    S : Cholesky factor of their covariance, as of `cho_factor`
    D : (k, 3) array, the Jacobian of the conditions by g

    """

    pose: Array
    P: Array
    chi2: float
    dof: int
    shared: Variables
    r: Array
    S: tuple[Array, bool]
    D: Array

    def most_contradicted(self) -> tuple[RendezvousKey | None, float]:
        """Return the place without which chi2 is least, and by how much less it is."""
        weight = cho_solve(self.S, np.eye(len(self.r)))
        weight -= weight @ self.D @ self.P @ self.D.T @ weight
        weighted = weight @ self.r
        worst, most, start = None, 0.0, 0
        for variable in self.shared:
            own = slice(start, start + variable.slot.size)
            start = own.stop
            if isinstance(variable, RendezvousPoint):
                drop = float(weighted[own] @ np.linalg.lstsq(weight[own, own], weighted[own])[0])
                if drop > most:
                    worst, most = variable.key, drop
        return worst, most


class MapJoiner:
    """
    Joins the state of one filter to that of another, if what they share allows it.

    Parameters
    ----------
    min_landmarks : so many landmarks must be in both
    probability : a right join is accepted with this chi-square probability
    heading_sigma : with a heading less certain than this [rad] what is far away depends on more
        than its first order: 60 runs among 20 landmarks gave NEES / 3 of 1.27 with 0.05, 1.31 with
        0.1, 1.36 with 0.2 and 21 with 1

    """

    def __init__(
        self, min_landmarks: int, probability: float, heading_sigma: float = 0.1
    ) -> None:
        self._min_landmarks = min_landmarks
        self._tail = 1.0 - probability
        self._heading_sigma = heading_sigma

    def join(self, team: Filter, group: Filter) -> JoinFailure | None:
        """Put everything of the group into the team and return None, or return why not."""
        landmarks = len(team.state.landmarks.keys() & group.state.landmarks.keys())
        places = len(team.state.rendezvous_points.keys() & group.state.rendezvous_points.keys())
        told = _counted(landmarks, 'shared landmark')
        if places:
            told += f' and {_counted(places, "observation")} of robots'
        if landmarks + places < self._min_landmarks:
            return JoinFailure(f'{told}, needs {self._min_landmarks}')
        seen = _from_within(group)
        found = fit(team.state, seen)
        limit = float(chdtri(found.dof, self._tail))
        if found.chi2 > limit:
            worst, drop = found.most_contradicted()
            # The others must tell without it.
            is_wrong = drop > WRONG_FROM and landmarks + places > self._min_landmarks
            return JoinFailure(
                f'{told} do not fit: chi-square {found.chi2:.1f}, limit {limit:.1f}',
                outlier=worst if is_wrong else None, d2=drop)
        sigma = _heading_sigma(found)
        if sigma > self._heading_sigma:
            # The heading of the team's own frame does not matter: it is that of all of the team.
            sigma = min(sigma, _heading_sigma(fit(_from_within(team), seen)))
        if sigma > self._heading_sigma:
            return JoinFailure(
                f'{told} tell its heading to {sigma:.2f} rad only, needs {self._heading_sigma}')
        team.state = joined(team.state, seen, found.pose, team.linearization)
        return None

    def locate(self, team: Filter, group: Filter, name: str, pose: Array, P: Array) -> bool:
        """
        Put a robot of a group into the team, given where it is; `bring` the rest afterwards.

        Parameters
        ----------
        team, group : the filters
        name : the robot
        pose, P : (3,) and (3, 3) array, its pose in the team's frame and the covariance

        Returns
        -------
        bool
            Whether the pose fits the landmarks that both know; else nothing has changed.

        """
        told = deepcopy(team.state)
        told.insert_robot(name, group.state.robots[name].stamp, pose, P)
        fits = self._accepts(fit(told, group.state))
        if fits:
            team.state = told
        return fits

    def bring(self, team: Filter, group: Filter, name: str) -> bool:
        """
        Put everything of a group into the team, which one of its robots is part of already.

        What the team knows of that robot must be independent of what the group knows.

        Returns
        -------
        bool
            Whether that was done. Else the robot has left the group, whose map may join later: it
            does not fit, or the heading of the robot does not tell well enough where it lies.

        """
        robot = group.state.robots[name]
        if group.state.variables() == [robot]:
            return True
        found = fit(team.state, group.state)
        if self._accepts(found) and _heading_sigma(found) <= self._heading_sigma:
            team.state = joined(team.state, group.state, found.pose, team.linearization)
            return True
        group.state.remove(robot)
        return False

    def _accepts(self, found: FrameFit) -> bool:
        return found.dof == 0 or found.chi2 <= float(chdtri(found.dof, self._tail))


def _from_within(of: Filter) -> JointState:
    """Return a state as its first robot sees it, where it has one: frames may begin far away."""
    robot = next(iter(of.state.robots.values()), None)
    return of.state if robot is None else in_frame_of(of.state, robot, of.linearization)


def shared_variables(team: JointState, group: JointState) -> tuple[list[Variable], list[Variable]]:
    """Return what is in both states, robots first: as it is in the one and in the other."""
    ours: list[Variable] = [r for name, r in team.robots.items() if name in group.robots]
    theirs: list[Variable] = [group.robots[name] for name in team.robots if name in group.robots]
    ours += [f for key, f in team.landmarks.items() if key in group.landmarks]
    theirs += [group.landmarks[key] for key in team.landmarks if key in group.landmarks]
    ours += [place for key, place in team.rendezvous_points.items() if key in group.rendezvous_points]
    theirs += [group.rendezvous_points[key] for key in team.rendezvous_points if key in group.rendezvous_points]
    return ours, theirs


def fit(team: JointState, group: JointState) -> FrameFit:
    """
    Return the pose of the group's frame in the team's, by weighted least squares.

    The weight of all conditions together is the inverse of P_T + C P_L C^T.

    """
    ours, theirs = shared_variables(team, group)
    x_T, P_T = team.estimates_of(_indices(ours)), team.marginal(ours)
    x_L, P_L = group.estimates_of(_indices(theirs)), group.marginal(theirs)
    g = _first_guess(x_T, x_L, ours)
    for _ in range(MAX_ITERATIONS):
        carried = _carried(g, x_L, ours)
        C, D = _derivatives(g, carried, ours)
        r = _difference(x_T, carried, ours)
        S = cho_factor(P_T + C @ P_L @ C.T, lower=True)
        information = D.T @ cho_solve(S, D)
        dg = np.linalg.solve(information, D.T @ cho_solve(S, r))
        g = _wrapped(g + dg)
        if np.abs(dg).max() < TOLERANCE:
            break
    P = cho_solve(cho_factor(information), np.eye(3))
    return FrameFit(g, P, float(r @ cho_solve(S, r)), len(r) - 3, ours, r, S, D)


def _heading_sigma(found: FrameFit) -> float:
    return float(np.sqrt(found.P[2, 2]))


def joined(
    team: JointState, group: JointState, g: Array, linearization: Linearization
) -> JointState:
    """
    Return the team's state with everything of the group, as seen from the team's frame.

    What both have keeps the team's place and first estimate. What is new has as its first estimate
    the group's estimate carried by g, because there its dependence on g is linearised.

    Parameters
    ----------
    team, group : the states, of which neither is changed
    g : (3,) array, pose of the group's frame in the team's
    linearization : where the conditions are linearised

    """
    ours, theirs = shared_variables(team, group)
    new = [variable for variable in group.variables() if variable not in theirs]
    first = _carried(g, group.estimates_of(_indices(new)), new)
    at, new_at = linearization.joining_points(team, ours, new, first)
    n, k = len(team.x_hat), len(group.x_hat)
    # The conditions are A dz - D dg = r, for z = [x_T, x_L].
    C, D = _derivatives(g, at, ours)
    A = np.hstack([_picks(ours, n), -C @ _picks(theirs, k)])
    carried = _carried(g, group.estimates_of(_indices(theirs)), ours)
    r = _difference(carried, team.estimates_of(_indices(ours)), ours)
    P = block_diag(team.marginal(team.variables()), group.marginal(group.variables()))
    dz, dg, P_zg = _conditioned(P, A, D, r)

    C, D = _derivatives(g, new_at, new)
    M = np.vstack([
        np.eye(n, n + k + 3),
        np.hstack([np.zeros((len(first), n)), C @ _picks(new, k), D])])
    x_new = (group.estimates() + dz[n:])[_indices(new)]
    x_hat = np.concatenate([team.estimates() + dz[:n], _carried(_wrapped(g + dg), x_new, new)])
    x_first = np.concatenate([team.x_first, first])
    state = _combined(team, new, x_hat, x_first, M @ P_zg @ M.T)
    transport_errors(linearization, state, np.concatenate([team.estimates(), first]))
    # Where robots of one frame have seen each other is of no more use.
    marginalize([place for place in team.rendezvous_points if place in group.rendezvous_points], [state])
    return state


def _conditioned(P: Array, A: Array, D: Array, r: Array) -> tuple[Array, Array, Array]:
    """Return dz, dg and the covariance of [z, g] where A dz - D dg = r; P is that of z before."""
    L = cholesky(A @ P @ A.T, lower=True)
    W, B, y = (solve_triangular(L, x, lower=True) for x in (A @ P, -D, r))
    # Rotated by Q^T, the first three of the white conditions are all that concern g.
    Q, R = qr(B)
    W, y = Q.T @ W, Q.T @ y
    R_inverse = solve_triangular(R[:3], np.eye(3))
    P_gz = -R_inverse @ W[:3]
    P_zg = np.block([[P - W[3:].T @ W[3:], P_gz.T], [P_gz, R_inverse @ R_inverse.T]])
    return W[3:].T @ y[3:], R_inverse @ y[:3], P_zg


def _combined(
    team: JointState, new: Variables, x_hat: Array, x_first: Array, P: Array
) -> JointState:
    """Return a state in which the new variables follow the team's."""
    covariance = Covariance()
    old = team.variables()
    slots = iter(covariance.insert(P).split([v.slot.size for v in [*old, *new]]))
    moved = [replace(variable, slot=next(slots)) for variable in [*old, *new]]
    state = JointState(moved, x_hat, x_first, covariance)
    headings = state.headings()
    state.x_hat[headings] = wrap_all(state.x_hat[headings])
    return state


def _first_guess(x_T: Array, x_L: Array, shared: Variables) -> Array:
    """Return g by a shared robot, or by the shared landmarks."""
    if isinstance(shared[0], Robot):
        return compose(x_T[:3], between(x_L[:3], np.zeros(3)))
    return rigid_fit(x_L.reshape(-1, 2), x_T.reshape(-1, 2))


def _carried(g: Array, x: Array, variables: Variables) -> Array:
    """Return g o x of stacked variables."""
    moved = [
        compose(g, part) if len(part) == POSE_SIZE else transform(g, part)
        for part in _parts(x, variables)]
    return np.concatenate([np.empty(0), *moved])


def _derivatives(g: Array, at: Array, variables: Variables) -> tuple[Array, Array]:
    """Return the Jacobians of g o x by x and by g, where g o x is linearised at `at`."""
    C = rotation(g[2])
    by_x, by_g = np.eye(len(at)), np.empty((len(at), 3))
    start = 0
    for part in _parts(at, variables):
        position, stop = slice(start, start + 2), start + len(part)
        by_x[position, position] = C
        by_g[start:stop] = np.eye(len(part), 3)
        by_g[position, 2] = perpendicular(part[:2] - g[:2])
        start = stop
    return by_x, by_g


def _difference(a: Array, b: Array, variables: Variables) -> Array:
    """Return a - b of stacked variables, headings wrapped."""
    parts = _parts(a - b, variables)
    return np.concatenate([np.append(part[:2], wrap_all(part[2:])) for part in parts])


def _parts(x: Array, variables: Variables) -> Iterator[Array]:
    """Yield the values of stacked variables."""
    start = 0
    for variable in variables:
        yield x[start:start + variable.slot.size]
        start += variable.slot.size


def _indices(variables: Variables) -> Indices:
    """Return the slots of some variables, stacked."""
    return np.concatenate([np.empty(0, np.intp), *(v.slot.indices for v in variables)])


def _picks(variables: Variables, n: int) -> Array:
    """Return the matrix (m, n) that takes some variables out of a joint vector."""
    picks: Array = np.eye(n)[_indices(variables)]
    return picks


def _counted(count: int, what: str) -> str:
    return f'{count} {what}' if count == 1 else f'{count} {what}s'


def _wrapped(pose: Array) -> Array:
    return np.array([pose[0], pose[1], wrap(pose[2])])
