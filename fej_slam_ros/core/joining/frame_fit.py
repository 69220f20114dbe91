# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pose of one frame in another from the variables shared by the joint states of both.

Each shared variable x, x' in the other frame, gives the condition x = g o x' on the pose
g = (t, alpha) of that frame.
"""

from collections.abc import Container, Iterator
from dataclasses import dataclass
from operator import itemgetter

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.ekf.covariance import joint_indices
from fej_slam_ros.core.ekf.state import (
    JointState, Landmark, POSITION, position_indices, RendezvousPoint, Robot, Variable, Variables)
from fej_slam_ros.core.geometry import (
    Array, compose, inverse, perpendicular, poses_plus, rigid_fit, starts_of, transform,
    wrap_all)
from fej_slam_ros.core.joining.initial_alignment import RELATIVE_PRECISION
from fej_slam_ros.core.records import LandmarkKey, RendezvousKey

#: The iteration ends with a step below this [m, rad], or below rounding.
FIT_TOLERANCE = 1e-10
MAX_FIT_ITERATIONS = 50
#: Points that are closer to each other than this, relative to their distance from the origin, are
#: one place, which determines no heading.
MIN_RELATIVE_SPREAD = 1e-6

POSE_SIZE = 3


class StackedVariables:
    """Variables of a frame, stacked in one vector x (n,), and the motion g o x of all of them."""

    def __init__(self, variables: Variables) -> None:
        self.variables = variables
        #: (n,) array, the states of x in the joint state of the frame
        self.indices = joint_indices([variable.slot for variable in variables])
        sizes = np.array([variable.slot.size for variable in variables], np.intp)
        starts = starts_of(sizes)
        # Where in x the positions (k, 2) and the headings are.
        self._positions = starts[:, None] + POSITION
        self._headings = starts[sizes == POSE_SIZE] + 2

    def carried(self, g: Array, x: Array) -> Array:
        """Return g o x."""
        moved = x.copy()
        moved[self._positions] = transform(g, x[self._positions])
        moved[self._headings] = wrap_all(x[self._headings] + g[2])
        return moved

    def turned(self, g: Array, rows: Array) -> Array:
        """Return C rows (n, m), where C is the Jacobian of g o x by x."""
        (x, y), c, s = self._positions.T, np.cos(g[2]), np.sin(g[2])
        product = rows.copy()
        product[x], product[y] = c * rows[x] - s * rows[y], s * rows[x] + c * rows[y]
        return product

    def turned_covariance(self, g: Array, P: Array) -> Array:
        """Return C P C^T of a covariance P (n, n) of x."""
        return self.turned(g, self.turned(g, P).T)

    def derivative(self, g: Array, at: Array) -> Array:
        """Return the Jacobian (n, 3) of g o x by g, linearised at g o x = `at`."""
        x, y = self._positions.T
        D = np.zeros((len(at), 3))
        D[x, 0] = D[y, 1] = D[self._headings, 2] = 1.0
        D[self._positions, 2] = perpendicular(at[self._positions] - g[:2])
        return D

    def difference(self, a: Array, b: Array) -> Array:
        """Return a - b, headings wrapped."""
        r = a - b
        r[self._headings] = wrap_all(r[self._headings])
        return r


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

    def limit(self, tail: float) -> float:
        """Return the chi2 that correct variables exceed with a probability."""
        return chi_square_limit(self.dof, tail)

    def is_consistent(self, tail: float) -> bool:
        """Return whether chi2 is within its limit, as it always is without degrees of freedom."""
        return self.dof == 0 or self.chi2 <= self.limit(tail)

    def heading_sigma(self) -> float:
        """Return the standard deviation of the heading of g [rad]."""
        return float(np.sqrt(self.P[2, 2]))

    def worst_rendezvous_point(self) -> tuple[RendezvousKey | None, float]:
        """Return the rendezvous point without which chi2 is least, and the decrease of chi2."""
        return max(
            ((variable.key, decrease) for variable, decrease in self._decreases_of_chi2()
             if isinstance(variable, RendezvousPoint)),
            key=itemgetter(1), default=(None, 0.0))

    def worst_landmark(self) -> LandmarkKey:
        """Return the landmark without which chi2 is least."""
        key, _ = max(
            ((variable.key, decrease) for variable, decrease in self._decreases_of_chi2()
             if isinstance(variable, Landmark)), key=itemgetter(1))
        return key

    def _decreases_of_chi2(self) -> Iterator[tuple[Variable, float]]:
        """Yield the shared variables, and by how much chi2 decreases without each."""
        weight = cho_solve(self.S_factor, np.eye(len(self.r)))
        weight -= weight @ self.D @ self.P @ self.D.T @ weight
        weighted, start = weight @ self.r, 0
        for variable in self.shared:
            own = slice(start, start + variable.slot.size)
            start = own.stop
            left_out, *_ = np.linalg.lstsq(weight[own, own], weighted[own], rcond=None)
            yield variable, float(weighted[own] @ left_out)


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
    points = group.estimates_of(position_indices(theirs))
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
    ours, theirs = map(StackedVariables, shared_variables(team, group, left_out))
    x_T, P_T = team.estimates_of(ours.indices), team.marginal(ours.variables)
    x_L, P_L = group.estimates_of(theirs.indices), group.marginal(theirs.variables)
    g = _closed_form(x_T, x_L, ours.variables)
    smallest = max(FIT_TOLERANCE, RELATIVE_PRECISION * float(np.abs(x_T).max()))
    for _ in range(MAX_FIT_ITERATIONS):
        x_carried = ours.carried(g, x_L)
        D = ours.derivative(g, x_carried)
        r = ours.difference(x_T, x_carried)
        S_factor = cho_factor(P_T + ours.turned_covariance(g, P_L), lower=True)
        information = D.T @ cho_solve(S_factor, D)
        dg = np.linalg.solve(information, D.T @ cho_solve(S_factor, r))
        g = poses_plus(g[None], dg)[0]
        if np.abs(dg).max() < smallest:
            break
    P = cho_solve(cho_factor(information), np.eye(3))
    return FrameFit(
        g, P, float(r @ cho_solve(S_factor, r)), len(r) - 3, ours.variables, r, S_factor, D)


def _closed_form(x_T: Array, x_L: Array, shared: Variables) -> Array:
    """Return g by a shared robot if there is one, else by the shared points."""
    if isinstance(shared[0], Robot):
        return compose(x_T[:3], inverse(x_L[:3]))
    return rigid_fit(x_L.reshape(-1, 2), x_T.reshape(-1, 2))
