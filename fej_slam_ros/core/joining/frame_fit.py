# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pose of one frame in another from the variables shared by the joint states of both.

Each shared variable x, x' in the other frame, gives the condition x = g o x' on the pose
g = (t, alpha) of that frame.
"""

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fej_slam_ros.core.ekf.state import JointState, POSITION, RendezvousPoint, Robot, Variable
from fej_slam_ros.core.geometry import (
    Array, compose, Indices, inverse, perpendicular, poses_plus, rigid_fit, transform, wrap_all)
from fej_slam_ros.core.records import LandmarkKey, RendezvousKey

#: The iteration ends with a step below this [m, rad].
FIT_TOLERANCE = 1e-10
MAX_FIT_ITERATIONS = 50
#: Points that are closer to each other than this, relative to their distance from the origin, are
#: one place, which determines no heading.
MIN_RELATIVE_SPREAD = 1e-6

Variables = Sequence[Variable]
POSE_SIZE = 3


@dataclass(frozen=True, slots=True, eq=False)
class FrameFit:
    """Pose of one frame in another by least squares over the shared variables."""

    pose: Array  #: (3,) array, g
    P: Array  #: (3, 3) array, covariance of g
    chi2: float  #: weighted squared residual of the conditions
    dof: int  #: degrees of freedom of chi2
    shared: Variables  #: variables of the conditions
    r: Array  #: (k,) array, residuals
    S_factor: tuple[Array, bool]  #: Cholesky factor of their covariance, as of `cho_factor`
    D: Array  #: (k, 3) array, Jacobian of the conditions with respect to g

    def heading_sigma(self) -> float:
        """Return the standard deviation of the heading of g [rad]."""
        return float(np.sqrt(self.P[2, 2]))

    def worst_rendezvous_point(self) -> tuple[RendezvousKey | None, float]:
        """Return the rendezvous point without which chi2 is least, and the decrease of chi2."""
        weight = cho_solve(self.S_factor, np.eye(len(self.r)))
        weight -= weight @ self.D @ self.P @ self.D.T @ weight
        weighted = weight @ self.r
        worst, largest, start = None, 0.0, 0
        for variable in self.shared:
            own = slice(start, start + variable.slot.size)
            start = own.stop
            if isinstance(variable, RendezvousPoint):
                left_out, *_ = np.linalg.lstsq(weight[own, own], weighted[own], rcond=None)
                drop = float(weighted[own] @ left_out)
                if drop > largest:
                    worst, largest = variable.key, drop
        return worst, largest


def shared_variables(
    team: JointState, group: JointState, left_out: Container[LandmarkKey] = ()
) -> tuple[list[Variable], list[Variable]]:
    """Return the shared variables of the team and of the group, robots first."""
    ours, theirs = (
        {**state.robots, **state.landmarks, **state.rendezvous_points} for state in (team, group))
    shared = [key for key in ours if key in theirs and key not in left_out]
    return [ours[key] for key in shared], [theirs[key] for key in shared]


def determine_heading(
    team: JointState, group: JointState, left_out: Container[LandmarkKey] = ()
) -> bool:
    """Return whether shared variables determine g: a robot does, points at one place do not."""
    _, theirs = shared_variables(team, group, left_out)
    if any(isinstance(variable, Robot) for variable in theirs):
        return True
    points = group.estimates_of(indices(theirs)).reshape(-1, 2)
    return bool(np.ptp(points, axis=0).max() > MIN_RELATIVE_SPREAD * np.abs(points).max())


def fit(
    team: JointState, group: JointState, left_out: Container[LandmarkKey] = ()
) -> FrameFit:
    """
    Return the pose g of the group's frame in the team's, which shared variables must determine.

    Least squares over all shared variables jointly, but for landmarks that are left out, weighted
    by (P_T + C P_L C^T)^-1 at the present g. The weight changes with g, so the iteration may cycle
    between poses that fit equally badly; then the last pose is returned.

    """
    ours, theirs = shared_variables(team, group, left_out)
    x_T, P_T = team.estimates_of(indices(ours)), team.marginal(ours)
    x_L, P_L = group.estimates_of(indices(theirs)), group.marginal(theirs)
    g = _closed_form(x_T, x_L, ours)
    for _ in range(MAX_FIT_ITERATIONS):
        x_carried = carried(g, x_L, ours)
        D = derivative(g, x_carried, ours)
        r = difference(x_T, x_carried, ours)
        S_factor = cho_factor(P_T + turned(g, turned(g, P_L, ours).T, ours), lower=True)
        information = D.T @ cho_solve(S_factor, D)
        dg = np.linalg.solve(information, D.T @ cho_solve(S_factor, r))
        g = poses_plus(g[None], dg)[0]
        if np.abs(dg).max() < FIT_TOLERANCE:
            break
    P = cho_solve(cho_factor(information), np.eye(3))
    return FrameFit(g, P, float(r @ cho_solve(S_factor, r)), len(r) - 3, ours, r, S_factor, D)


def _closed_form(x_T: Array, x_L: Array, shared: Variables) -> Array:
    """Return g by a shared robot if there is one, else by the shared points."""
    if isinstance(shared[0], Robot):
        return compose(x_T[:3], inverse(x_L[:3]))
    return rigid_fit(x_L.reshape(-1, 2), x_T.reshape(-1, 2))


def carried(g: Array, x: Array, variables: Variables) -> Array:
    """Return g o x of stacked variables."""
    positions, headings = _layout(variables)
    moved = x.copy()
    moved[positions] = transform(g, x[positions])
    moved[headings] = wrap_all(x[headings] + g[2])
    return moved


def turned(g: Array, rows: Array, variables: Variables) -> Array:
    """Return C rows, where C is the Jacobian of g o x by the stacked variables x."""
    (x, y), c, s = _layout(variables)[0].T, np.cos(g[2]), np.sin(g[2])
    product = rows.copy()
    product[x], product[y] = c * rows[x] - s * rows[y], s * rows[x] + c * rows[y]
    return product


def derivative(g: Array, at: Array, variables: Variables) -> Array:
    """Return the Jacobian of g o x by g, linearised at g o x = `at`."""
    positions, headings = _layout(variables)
    D = np.zeros((len(at), 3))
    D[positions[:, 0], 0] = D[positions[:, 1], 1] = D[headings, 2] = 1.0
    D[positions, 2] = perpendicular(at[positions] - g[:2])
    return D


def difference(a: Array, b: Array, variables: Variables) -> Array:
    """Return a - b of stacked variables, headings wrapped."""
    (_, headings), r = _layout(variables), a - b
    r[headings] = wrap_all(r[headings])
    return r


def _layout(variables: Variables) -> tuple[Indices, Indices]:
    """Return the indices of the positions (k, 2) and of the headings of stacked variables."""
    sizes = np.array([variable.slot.size for variable in variables], np.intp)
    starts = np.cumsum(sizes) - sizes
    return starts[:, None] + POSITION, starts[sizes == POSE_SIZE] + 2


def indices(variables: Variables) -> Indices:
    """Return the indices of the states of variables, stacked."""
    return np.concatenate([np.empty(0, np.intp), *(v.slot.indices for v in variables)])
