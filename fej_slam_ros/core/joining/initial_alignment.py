# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Least squares of step 0, eq. (12) of [Liu].

The paper solves for one robot with respect to an exactly known one. Here all robots whose poses
the observations determine are solved for jointly, with respect to the poses known before (an
uncertain anchor, robots with an initial pose). These enter as a prior x = x_prior + T xi with
xi ~ N(0, I) and P = T T^T, so that a prior without uncertainty is no special case.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, LinAlgError, solve_triangular

from fej_slam_ros.core import models
from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.ekf.gating import CONTRADICTION_PROBABILITY
from fej_slam_ros.core.ekf.linearization import Points, Poses
from fej_slam_ros.core.ekf.matrix_product import product
from fej_slam_ros.core.gauss_newton import ConvergenceError, gauss_newton
from fej_slam_ros.core.geometry import Array, compose, Indices, rigid_fit, transform, wrap_all
from fej_slam_ros.core.pieces import pause
from fej_slam_ros.core.records import LandmarkKey, Observation

#: Observations of each robot at step 0; a landmark may be observed more than once.
InitialScans = Mapping[str, Sequence[tuple[LandmarkKey, Observation]]]

#: Maps the solution to the points at which the covariance is linearised.
LinearizedAt = Callable[[Poses, Points], tuple[Poses, Points]]

#: Smallest distance [m] between two landmarks that determine a heading.
MIN_BASELINE = 1e-6
#: Maximum number of steps; a handful is usual.
MAX_STEP0_ITERATIONS = 100
#: A smaller predicted decrease of the cost, which has no unit, is rounding.
MIN_DECREASE = 1e-22
#: Smallest increment of a coordinate that rounding allows, relative to the coordinate.
RELATIVE_PRECISION = 16 * float(np.finfo(float).eps)


class InitialAlignmentError(ArithmeticError):
    """The observations of step 0 do not determine the unknowns, or contradict each other."""


@dataclass(frozen=True, slots=True, eq=False)
class InitialAlignment:
    """Robots and landmarks in one frame with their joint covariance."""

    poses: Poses  #: (3,) array of each robot
    points: Points  #: (2,) array of each landmark
    P: Array  #: joint covariance, poses before points, each in the order of its mapping


def closed_form(poses: Poses, points: Points, scans: InitialScans) -> tuple[Poses, Points]:
    """
    Return a first guess of all robots and landmarks that are connected to the known ones.

    Groups of robots that share two landmarks are joined rigidly until no two such groups remain;
    groups without a known robot are left out. A linkage, in which groups share one landmark each,
    has several solutions and counts as not determined.

    """
    groups: list[tuple[Poses, Points]] = [
        (dict(poses), dict(points)),
        *(({robot: np.zeros(3)}, {}) for robot in scans if robot not in poses)]
    for group_poses, group_points in groups:
        for robot, pose in group_poses.items():
            for key, observation in scans.get(robot, ()):
                group_points.setdefault(key, transform(pose, observation.z))
    while _join_two(groups):
        pass
    return groups[0]


def align(
    prior: InitialAlignment, guess: Poses, guess_points: Points, scans: InitialScans,
    linearized_at: LinearizedAt = lambda poses, points: (poses, points),
    tolerance: float = 1e-12,
) -> InitialAlignment:
    """
    Solve eq. (12) for new robots and landmarks with respect to a prior, by Gauss-Newton.

    Parameters
    ----------
    prior : known robots and landmarks
    guess, guess_points : first guesses of new robots and landmarks
    scans : observations by all these robots; those of other landmarks are ignored
    linearized_at : points at which the covariance is linearised, given the last linearisation
        (which at the default tolerance is the solution)
    tolerance : the iteration ends below this |dx|, or when rounding prevents smaller steps

    Raises
    ------
    InitialAlignmentError
        If the normal matrix is singular, the iteration does not converge, or the cost is one that
        correct observations have in one of 10^9 cases.

    """
    problem = _Problem(prior, guess, guess_points, scans, tolerance)
    start = problem.stacked(prior.poses | guess, prior.points | guess_points)
    try:
        (x, xi), last, _ = gauss_newton(
            problem, (start, np.zeros(len(prior.P))), MAX_STEP0_ITERATIONS)
    except ConvergenceError as error:
        raise InitialAlignmentError(f'step 0: {error}') from None
    if problem.dof and last.cost > chi_square_limit(problem.dof, CONTRADICTION_PROBABILITY):
        raise InitialAlignmentError('the observations of step 0 contradict each other')
    x_lin = problem.stacked(*linearized_at(*problem.unstacked(last.x)))
    return InitialAlignment(
        *problem.unstacked(x), problem.covariance(problem.linearize((x_lin, xi))))


def align_independently(
    prior: InitialAlignment, guess: Poses, guess_points: Points, scans: InitialScans,
    linearized_at: LinearizedAt = lambda poses, points: (poses, points),
    tolerance: float = 1e-12,
) -> InitialAlignment:
    """
    Solve as `align`, with the paper's P_0 = diag(P_anchor, P_s); the first robot is the anchor.

    The anchor is exact in the solution; its covariance is added afterwards, without cross terms.
    For an uncertain anchor the result is inconsistent.

    """
    exact = prior.P.copy()
    exact[:3, :] = exact[:, :3] = 0.0
    solved = align(
        InitialAlignment(prior.poses, prior.points, exact), guess, guess_points, scans,
        linearized_at, tolerance)
    solved.P[:3, :3] = prior.P[:3, :3]
    return solved


#: All poses, then all points, stacked, and the prior's coordinates xi.
_Unknowns = tuple[Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class _LinearizedStep0:
    """Normal equations N dx = g at the stacked poses and points x."""

    x: Array
    N: Array
    g: Array
    cost: float


class _Problem:
    """Eq. (12) in the unknowns [xi, new poses, new points]; see `gauss_newton`."""

    def __init__(
        self, prior: InitialAlignment, poses: Poses, points: Points, scans: InitialScans,
        tolerance: float,
    ) -> None:
        names, keys = [*prior.poses, *poses], [*prior.points, *points]
        self._pose_at = {name: 3 * k for k, name in enumerate(names)}
        self._point_at = {key: 3 * len(names) + 2 * k for k, key in enumerate(keys)}
        self._observations = [
            (self._pose_at[name], self._point_at[key], observation)
            for name in names for key, observation in scans.get(name, ())
            if key in self._point_at]
        self._tolerance = tolerance
        #: Number of measurements in excess of the unknowns
        self.dof = 2 * len(self._observations) - 3 * len(poses) - 2 * len(points)
        # T with dx_joint = T [xi, new poses, new points].
        dimension, n = 3 * len(names) + 2 * len(keys), len(prior.P)
        known = np.zeros(dimension, dtype=bool)
        known[:3 * len(prior.poses)] = True
        known[3 * len(names):][:2 * len(prior.points)] = True
        w, V = np.linalg.eigh(prior.P)
        self._T = np.zeros((dimension, dimension))
        self._T[known, :n] = V * np.sqrt(np.maximum(w, 0.0))
        self._T[~known, n:] = np.eye(dimension - n)

    def stacked(self, poses: Poses, points: Points) -> Array:
        return np.concatenate([
            *(poses[name] for name in self._pose_at), *(points[key] for key in self._point_at)])

    def unstacked(self, x: Array) -> tuple[Poses, Points]:
        return (
            {name: x[a:a + 3] for name, a in self._pose_at.items()},
            {key: x[a:a + 2] for key, a in self._point_at.items()})

    def linearize(self, x: _Unknowns) -> _LinearizedStep0:
        joint, xi = x
        Lambda = np.zeros((len(self._T), len(self._T)))
        eta, cost = np.zeros(len(self._T)), float(xi @ xi)
        for columns, H, r in self._rows(joint):
            Lambda[np.ix_(columns, columns)] += H.T @ H
            eta[columns] += H.T @ r
            cost += float(r @ r)
        T = self._T
        N, g = product(product(T.T, Lambda, may_end=True), T, may_end=True), T.T @ eta
        N[np.arange(len(xi)), np.arange(len(xi))] += 1.0
        g[:len(xi)] -= xi
        return _LinearizedStep0(joint, N, g, cost)

    def step(self, at: _LinearizedStep0, damping: float) -> tuple[Array, float]:
        """Return the increment of the unknowns; there is no damping."""
        dx: Array = cho_solve(_factor(at.N), at.g)
        return dx, float(at.g @ dx)

    def retract(self, x: _Unknowns, dx: Array) -> _Unknowns:
        joint, xi = x
        moved = joint + self._T @ dx
        headings = slice(2, 3 * len(self._pose_at), 3)
        moved[headings] = wrap_all(moved[headings])
        return moved, xi + dx[:len(xi)]

    def has_converged(self, x: _Unknowns, dx: Array, decrease: float) -> bool:
        """Return whether |dx| is below the tolerance or lost in rounding."""
        smallest = max(self._tolerance, RELATIVE_PRECISION * float(np.abs(x[0]).max()))
        return bool(np.linalg.norm(dx) < smallest or decrease < MIN_DECREASE)

    def covariance(self, at: _LinearizedStep0) -> Array:
        """Return the joint covariance T N^-1 T^T."""
        half: Array = solve_triangular(_factor(at.N)[0], self._T.T, lower=True)
        return product(half.T, half, may_end=True)

    def _rows(self, x: Array) -> Iterator[tuple[Indices, Array, Array]]:
        """Yield columns (5,), whitened Jacobian (2, 5) and residual (2,) of each observation."""
        for a, b, observation in self._observations:
            pose, point = x[None, a:a + 3], x[None, b:b + 2]
            R_sqrt = np.linalg.cholesky(observation.R)
            H = solve_triangular(R_sqrt, models.H(pose, point)[0], lower=True)
            r = solve_triangular(R_sqrt, observation.z - models.h(pose, point)[0], lower=True)
            yield np.array([a, a + 1, a + 2, b, b + 1]), H, r
            pause()


def _factor(normal: Array) -> tuple[Array, bool]:
    try:
        factor: tuple[Array, bool] = cho_factor(normal, lower=True)
    except LinAlgError:
        raise InitialAlignmentError(
            'the observations of step 0 do not determine all poses') from None
    return factor


def _join_two(groups: list[tuple[Poses, Points]]) -> bool:
    """Move one group into the frame of an earlier one that shares two landmarks with it."""
    for (poses, points), other in combinations(groups, 2):
        shared = [key for key in points if key in other[1]]
        target = np.array([points[key] for key in shared]).reshape(-1, 2)
        if len(shared) < 2 or np.ptp(target, axis=0).max() < MIN_BASELINE:
            continue
        pose = rigid_fit(np.array([other[1][key] for key in shared]), target)
        poses.update({name: compose(pose, x) for name, x in other[0].items()})
        for key, x in other[1].items():
            points.setdefault(key, transform(pose, x))
        groups.remove(other)
        return True
    return False
