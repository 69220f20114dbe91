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
from fej_slam_ros.core.ekf.linearization import Points, Poses
from fej_slam_ros.core.gauss_newton import ConvergenceError, gauss_newton
from fej_slam_ros.core.geometry import Array, compose, Indices, rigid_fit, transform, wrap
from fej_slam_ros.core.records import LandmarkKey, Observation


#: Observations of each robot at step 0; a landmark may be observed more than once.
InitialScans = Mapping[str, Sequence[tuple[LandmarkKey, Observation]]]

#: Maps the solution to the points at which the covariance is linearised.
LinearizedAt = Callable[[Poses, Points], tuple[Poses, Points]]

#: Least distance [m] of two landmarks that determine a heading.
MIN_BASELINE = 1e-6
#: Steps of the iteration; a handful is usual.
MAX_STEP0_ITERATIONS = 100
#: A smaller predicted decrease of the cost, which has no unit, is rounding.
MIN_DECREASE = 1e-22
#: Smallest increment of a coordinate that rounding allows, relative to the coordinate.
RELATIVE_PRECISION = 16 * float(np.finfo(float).eps)


class InitialAlignmentError(ArithmeticError):
    """The observations of step 0 do not determine the unknowns."""


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
    groups without a known robot are left out. (A linkage, in which groups share one landmark
    each, has several solutions and counts as not determined.)

    Parameters
    ----------
    poses, points : known robots and landmarks
    scans : observations of every robot

    """
    frame: tuple[Poses, Points] = dict(poses), dict(points)
    for robot in poses:
        _add_points(*frame, robot, scans)
    groups = [frame]
    for robot in scans:
        if robot not in poses:
            group: tuple[Poses, Points] = {robot: np.zeros(3)}, {}
            _add_points(*group, robot, scans)
            groups.append(group)
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
    guess, guess_points : new robots and landmarks with their first guesses
    scans : observations by all these robots; those of other landmarks are ignored
    linearized_at : points at which the covariance is linearised, given the last linearisation
        (which at the default tolerance is the solution)
    tolerance : the iteration ends below this |dx|, or when rounding prevents smaller steps

    Raises
    ------
    InitialAlignmentError
        If the normal matrix is singular or the iteration does not converge.

    """
    problem = _Problem(prior, list(guess), list(guess_points), scans, tolerance)
    start = prior.poses | guess, prior.points | guess_points, np.zeros(len(prior.P))
    try:
        (poses, points, xi), last, _ = gauss_newton(problem, start, MAX_STEP0_ITERATIONS)
    except ConvergenceError as error:
        raise InitialAlignmentError(f'step 0: {error}') from None
    at = problem.linearize((*linearized_at(*last.x[:2]), xi))
    return InitialAlignment(poses, points, problem.covariance(at))


def align_independently(
    prior: InitialAlignment, guess: Poses, guess_points: Points, scans: InitialScans,
    linearized_at: LinearizedAt = lambda poses, points: (poses, points),
    tolerance: float = 1e-12,
) -> InitialAlignment:
    """
    Solve with the paper's P_0 = diag(P_anchor, P_s), the first robot being the anchor.

    The anchor is exact in the solution; its covariance is added afterwards, without cross terms.
    For an uncertain anchor the result is inconsistent. Parameters as for `align`.

    """
    exact = prior.P.copy()
    exact[:3, :] = exact[:, :3] = 0.0
    solved = align(
        InitialAlignment(prior.poses, prior.points, exact), guess, guess_points, scans,
        linearized_at, tolerance)
    solved.P[:3, :3] = prior.P[:3, :3]
    return solved


#: Poses, points, and the prior's coordinates xi.
_Unknowns = tuple[Poses, Points, Array]


@dataclass(frozen=True, slots=True, eq=False)
class _LinearizedStep0:
    """Normal equations N dx = g at x, where the cost is `cost`."""

    x: _Unknowns
    N: Array
    g: Array
    cost: float


class _Problem:
    """Eq. (12) in the unknowns [xi, new poses, new points], and their joint vector."""

    def __init__(
        self, prior: InitialAlignment, robots: Sequence[str], landmarks: Sequence[LandmarkKey],
        scans: InitialScans, tolerance: float,
    ) -> None:
        names = [*prior.poses, *robots]
        keys = [*prior.points, *landmarks]
        self._pose_at = {name: 3 * k for k, name in enumerate(names)}
        self._point_at = {key: 3 * len(names) + 2 * k for k, key in enumerate(keys)}
        self._observations = [
            (name, key, observation) for name in names for key, observation in scans.get(name, ())
            if key in self._point_at]
        self._T = self._embedding(prior, 3 * len(names) + 2 * len(keys))
        self._tolerance = tolerance

    def _embedding(self, prior: InitialAlignment, dimension: int) -> Array:
        """Return T with dx_joint = T [xi, new poses, new points]."""
        known = np.zeros(dimension, dtype=bool)
        for name in prior.poses:
            known[self._pose_at[name]:][:3] = True
        for key in prior.points:
            known[self._point_at[key]:][:2] = True
        T = np.zeros((dimension, dimension))
        n = len(prior.P)
        w, V = np.linalg.eigh(prior.P)
        T[known, :n] = V * np.sqrt(np.maximum(w, 0.0))
        T[~known, n:] = np.eye(dimension - n)
        return T

    def linearize(self, x: _Unknowns) -> _LinearizedStep0:
        """Return the normal equations at x."""
        poses, points, xi = x
        Lambda = np.zeros((len(self._T), len(self._T)))
        eta, cost = np.zeros(len(self._T)), float(xi @ xi)
        for columns, H, r in self._rows(poses, points):
            Lambda[np.ix_(columns, columns)] += H.T @ H
            eta[columns] += H.T @ r
            cost += float(r @ r)
        N, g = self._T.T @ Lambda @ self._T, self._T.T @ eta
        N[np.arange(len(xi)), np.arange(len(xi))] += 1.0
        g[: len(xi)] -= xi
        return _LinearizedStep0(x, N, g, cost)

    def step(self, at: _LinearizedStep0, damping: float) -> tuple[Array, float]:
        """Return the increment of the unknowns; there is no damping."""
        dx: Array = cho_solve(_factor(at.N), at.g)
        return dx, float(at.g @ dx)

    def retract(self, x: _Unknowns, dx: Array) -> _Unknowns:
        """Return x moved by dx."""
        poses, points, xi = x
        joint = self._T @ dx
        moved = {name: pose + joint[self._pose_at[name]:][:3] for name, pose in poses.items()}
        for pose in moved.values():
            pose[2] = wrap(pose[2])
        return moved, {
            key: point + joint[self._point_at[key]:][:2] for key, point in points.items()
        }, xi + dx[: len(xi)]

    def has_converged(self, x: _Unknowns, dx: Array, decrease: float) -> bool:
        """Return whether |dx| is below the tolerance or lost in rounding."""
        poses, points, _ = x
        largest = max(float(np.abs(v).max()) for v in (*poses.values(), *points.values()))
        return bool(
            np.linalg.norm(dx) < max(self._tolerance, RELATIVE_PRECISION * largest)
            or decrease < MIN_DECREASE)

    def covariance(self, at: _LinearizedStep0) -> Array:
        """Return the joint covariance T N^-1 T^T."""
        L, _ = _factor(at.N)
        half = solve_triangular(L, self._T.T, lower=True)
        P: Array = half.T @ half
        return P

    def _rows(self, poses: Poses, points: Points) -> Iterator[tuple[Indices, Array, Array]]:
        """Yield columns (5,), whitened Jacobian (2, 5) and residual (2,) of each observation."""
        for name, key, observation in self._observations:
            pose, point = poses[name][None], points[key][None]
            a, b = self._pose_at[name], self._point_at[key]
            columns = np.array([a, a + 1, a + 2, b, b + 1])
            R_sqrt = np.linalg.cholesky(observation.R)
            H = solve_triangular(R_sqrt, models.H(pose, point)[0], lower=True)
            r = solve_triangular(R_sqrt, observation.z - models.h(pose, point)[0], lower=True)
            yield columns, H, r


def _factor(normal: Array) -> tuple[Array, bool]:
    try:
        L, lower = cho_factor(normal, lower=True)
    except LinAlgError:
        raise InitialAlignmentError(
            'the observations of step 0 do not determine all poses') from None
    return L, lower


def _add_points(poses: Poses, points: Points, robot: str, scans: InitialScans) -> None:
    """Add the landmarks that a robot observes and that are not known yet."""
    for key, observation in scans.get(robot, ()):
        points.setdefault(key, transform(poses[robot], observation.z))


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
