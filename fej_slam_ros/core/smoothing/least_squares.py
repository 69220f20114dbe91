# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Least squares over all poses of all robots and all landmarks, in one frame.

The cost of poses x = [p, phi] and landmarks f is

    sum |u - x_begin^-1 o x_end|^2_Q + sum |z - C(phi)^T (f - p)|^2_R
    + sum |z - C(phi)^T (p_observed - p)|^2_R,    |r|^2_Q = r^T Q^-1 r,

with heading residuals wrapped. The first two sums are eq. (1) of [Andersson], and the batch
solution of eqs. (2) and (7) of [Liu]; with the third it is eq. (21) of [Andersson], whose base
node is the first pose of the other robot. Poses and landmarks are indexed from 0; the robot that a
pose belongs to does not matter. Consecutive indices along each trajectory are fastest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.gauss_newton import gauss_newton, NielsenDamping
from fej_slam_ros.core.geometry import Array, corrected, Indices, wrap_all
from fej_slam_ros.core.smoothing.marginals import Information
from fej_slam_ros.core.smoothing.normal_equations import Cholesky, diagonal, NormalEquations


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """Poses (n, 3) [m, m, rad] and landmarks (l, 2) [m] in one frame, each by index."""

    poses: Array
    points: Array


@dataclass(frozen=True, slots=True, eq=False)
class OdometryFactors:
    """K odometry increments."""

    #: begin, end: (K,) arrays, indices of the poses
    begin: Indices
    end: Indices
    u: Array  #: (K, 3) array, pose end in the frame of pose begin [m, m, rad]
    Q: Array  #: (3, 3) or (K, 3, 3) array, covariance of u

    def nodes(self, poses: int) -> tuple[Indices, Indices]:
        """Return the two variables of each factor; landmarks are counted after the poses."""
        return self.begin, self.end

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (K, 3, 6) and r (K, 3)."""
        begin, end = x.poses[self.begin], x.poses[self.end]
        r = self.u - np.column_stack([models.h(begin, end[:, :2]), end[:, 2] - begin[:, 2]])
        r[:, 2] = wrap_all(r[:, 2])
        return models.H_pose(begin, end), r


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkFactors:
    """m landmark observations."""

    #: pose, landmark: (m,) arrays, indices of the observing pose and of the landmark
    pose: Indices
    landmark: Indices
    z: Array  #: (m, 2) array, the landmark in the frame of the pose [m]
    R: Array  #: (2, 2) or (m, 2, 2) array, covariance of z

    def nodes(self, poses: int) -> tuple[Indices, Indices]:
        """Return the two variables of each factor; landmarks are counted after the poses."""
        return self.pose, poses + self.landmark

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 5) and r (m, 2), eqs. (13), (16) and (17) of [Andersson]."""
        poses, points = x.poses[self.pose], x.points[self.landmark]
        return models.H(poses, points), self.z - models.h(poses, points)


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousFactors:
    """m robot-to-robot observations."""

    #: pose, observed: (m,) arrays, indices of the observing and of the observed pose
    pose: Indices
    observed: Indices
    z: Array  #: (m, 2) array, position of the observed pose in the frame of the observing one [m]
    R: Array  #: (2, 2) or (m, 2, 2) array, covariance of z

    def nodes(self, poses: int) -> tuple[Indices, Indices]:
        """Return the two variables of each factor; landmarks are counted after the poses."""
        return self.pose, self.observed

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 6) and r (m, 2), eqs. (22) and (23) of [Andersson]."""
        poses, observed = x.poses[self.pose], x.poses[self.observed]
        return models.H_pose(poses, observed)[:, :2], self.z - models.h(poses, observed[:, :2])


FactorsT = TypeVar('FactorsT', OdometryFactors, LandmarkFactors, RendezvousFactors)


def covariance(factors: OdometryFactors | LandmarkFactors | RendezvousFactors) -> Array:
    """Return Q or R of some factors."""
    return factors.Q if isinstance(factors, OdometryFactors) else factors.R


def concatenated(*parts: FactorsT) -> FactorsT:
    """Return factors of one kind as one, in the same order, with one covariance each."""
    begin, end, z, _ = zip(*(
        [getattr(part, field.name) for field in fields(part)] for part in parts))
    R = [_repeated(covariance(part), len(values)) for part, values in zip(parts, z)]
    return type(parts[0])(*map(np.concatenate, (begin, end, z, R)))


def _repeated(R: Array, count: int) -> Array:
    """Return (count, d, d) covariances from one or from as many."""
    return np.broadcast_to(R, (count, *R.shape[-2:]))


NO_RENDEZVOUS = RendezvousFactors(
    np.empty(0, np.intp), np.empty(0, np.intp), np.empty((0, 2)), np.eye(2))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All measurements."""

    #: odometry, landmarks, rendezvous: the factors
    odometry: OdometryFactors
    landmarks: LandmarkFactors
    rendezvous: RendezvousFactors = NO_RENDEZVOUS
    #: fixed_poses, fixed_landmarks: indices of the variables that keep their initial values; each
    #: group of connected robots needs one such pose
    fixed_poses: Sequence[int] = (0,)
    fixed_landmarks: Sequence[int] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A minimum of the cost."""

    values: Values  #: poses and landmarks at the minimum
    cost: float  #: chi-square, if Q and R are the covariances of the measurements
    unknowns: int  #: number of coordinates solved for
    iterations: int  #: number of steps
    rejected: int  #: number of steps that would have raised the cost and were damped instead


def solve(
    problem: Problem, start: Values, tolerance: float = 1e-9, max_iterations: int = 100
) -> Solution:
    """
    Return the minimum that damped Gauss-Newton reaches from a start.

    The minimum need not be the global one: far from the truth it depends on the start.

    Parameters
    ----------
    problem : the measurements, at least one
    start : initial values
    tolerance : largest increment of a coordinate at the end [m, rad]
    max_iterations : number of steps after which the iteration is given up

    Raises
    ------
    SingularError, ConvergenceError
        The measurements do not determine all variables; the start is too far away.

    """
    system, damping = _System(problem, start, tolerance), NielsenDamping()
    values, _, iterations = gauss_newton(system, start, max_iterations, damping)
    return Solution(
        values, system.linearize(values).cost, len(system.equations.coordinates), iterations,
        damping.rejected)


def information(problem: Problem, values: Values) -> Information:
    """
    Return the information matrix and the covariances, linearised at some values.

    Raises
    ------
    SingularError
        The measurements do not determine all variables.

    """
    system = _System(problem, values)
    A = system.linearize(values).A
    return Information(
        system.equations.matrix(A), system.equations.coordinates,
        len(values.poses), len(values.points))


@dataclass(frozen=True, slots=True, eq=False)
class _LinearizedFactors:
    """The cost sum |b - A dx|^2 near some values; A (k, d, c) and b (k, d) of each kind."""

    A: list[Array]
    b: list[Array]
    cost: float


class _System:
    """Eq. (2) of [Andersson]: the steps of `gauss_newton` on a sparse problem."""

    def __init__(self, problem: Problem, start: Values, tolerance: float = 0.0) -> None:
        poses, points = len(start.poses), len(start.points)
        kinds = problem.odometry, problem.landmarks, problem.rendezvous
        self._factors = [factors for factors in kinds if len(factors.nodes(poses)[0]) > 0]
        self._whiteners = [whitener(covariance(factors)) for factors in self._factors]
        free = np.ones(poses + points, bool)
        free[list(problem.fixed_poses)] = False
        free[poses + np.array(problem.fixed_landmarks, np.intp)] = False
        self.equations = NormalEquations(
            np.repeat([3, 2], [poses, points]), np.flatnonzero(free),
            [factors.nodes(poses) for factors in self._factors])
        self._size = start.poses.size + start.points.size
        self._tolerance = tolerance

    def linearize(self, x: Values) -> _LinearizedFactors:
        """Return A and b, whitened."""
        H, r = zip(*(factors.linearize(x) for factors in self._factors))
        A = [L_inv @ H_k for L_inv, H_k in zip(self._whiteners, H)]
        b = [(L_inv @ r_k[:, :, None])[:, :, 0] for L_inv, r_k in zip(self._whiteners, r)]
        return _LinearizedFactors(A, b, float(sum(np.vdot(b_k, b_k) for b_k in b)))

    def step(self, at: _LinearizedFactors, damping: float) -> tuple[Array, float]:
        """Solve (A^T A + damping diag(A^T A)) dx = A^T b."""
        N, g = self.equations.matrix(at.A), self.equations.right_side(at.A, at.b)
        D = damping * N.diagonal()
        dx_free = Cholesky(N + diagonal(D) if damping > 0.0 else N).solve(g)
        dx = np.zeros(self._size)
        dx[self.equations.coordinates] = dx_free
        return dx, float(dx_free @ (g + D * dx_free))

    def retract(self, x: Values, dx: Array) -> Values:
        """Return x moved by dx, headings wrapped."""
        dx_poses, dx_points = np.split(dx, [x.poses.size])
        return Values(corrected(x.poses, dx_poses), x.points + dx_points.reshape(-1, 2))

    def has_converged(self, x: Values, dx: Array, decrease: float) -> bool:
        """Return whether no coordinate moved by the tolerance or more."""
        return bool(np.abs(dx).max(initial=0.0) < self._tolerance)


def whitener(R: Array) -> Array:
    """Return L^-1 of the covariance R = L L^T, one (d, d) or several (k, d, d)."""
    # numpy 1.26 takes a single identity for vectors where R is a stack.
    return np.linalg.solve(np.linalg.cholesky(R), np.broadcast_to(np.eye(R.shape[-1]), R.shape))
