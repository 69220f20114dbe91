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

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeVar

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.gauss_newton import gauss_newton, NielsenDamping, SingularError
from fej_slam_ros.core.geometry import Array, Indices, poses_plus, wrap_all
from fej_slam_ros.core.smoothing.cauchy_loss import CauchyLoss
from fej_slam_ros.core.smoothing.marginals import Information
from fej_slam_ros.core.smoothing.normal_equations import Cholesky, diagonal, NormalEquations
from fej_slam_ros.core.smoothing.odometry_chains import (
    ChainedIncrements, OdometryChains, ReducedChains)


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """Poses (n, 3) [m, m, rad] and landmarks (l, 2) [m] in one frame, each by index."""

    poses: Array
    points: Array


@dataclass(frozen=True, slots=True, eq=False)
class Factors(ABC):
    """m measurements, each from a pose to a target: a pose, or for some kinds a landmark."""

    DIMENSION: ClassVar[int] = 2

    #: pose, target: (m,) arrays, indices of the poses and of the targets
    pose: Indices
    target: Indices
    z: Array  #: (m, d) array, the target in the frame of the pose [m, (m, rad)]
    R: Array  #: (d, d) or (m, d, d) array, covariance of z

    def nodes(self, poses: int) -> tuple[Indices, Indices]:
        """Return the two variables (m,) of each factor; landmarks are counted after the poses."""
        return self.pose, self.target

    @abstractmethod
    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return the Jacobian H (m, d, c) with respect to the two nodes, and the residual r."""


class OdometryFactors(Factors):
    """Odometry increments u to a later pose with covariance Q."""

    __slots__ = ()
    DIMENSION = 3

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 3, 6) and r (m, 3)."""
        begin, end = x.poses[self.pose], x.poses[self.target]
        r = self.z - np.column_stack([models.h(begin, end[:, :2]), end[:, 2] - begin[:, 2]])
        r[:, 2] = wrap_all(r[:, 2])
        return models.H_pose(begin, end), r


class LandmarkFactors(Factors):
    """Observations of landmarks."""

    __slots__ = ()

    def nodes(self, poses: int) -> tuple[Indices, Indices]:
        """Return the pose and the landmark of each factor."""
        return self.pose, poses + self.target

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 5) and r (m, 2), eqs. (13), (16) and (17) of [Andersson]."""
        poses, points = x.poses[self.pose], x.points[self.target]
        return models.H(poses, points), self.z - models.h(poses, points)


class RendezvousFactors(Factors):
    """Robot-to-robot observations of the position of a pose."""

    __slots__ = ()

    def linearize(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 6) and r (m, 2), eqs. (22) and (23) of [Andersson]."""
        poses, observed = x.poses[self.pose], x.poses[self.target]
        return models.H_pose(poses, observed)[:, :2], self.z - models.h(poses, observed[:, :2])


#: Largest increment of a coordinate at the minimum [m, rad].
TOLERANCE = 1e-9
#: Largest increment [m, rad] after which the factor of A^T A is used again, and its largest ratio
#: to the one before, if that was found with the same factor: otherwise it converges too slowly.
MAX_REUSE_STEP, MAX_REUSE_RATIO = 1e-3, 0.2
#: A kind of factors, and pose, target, z and R of one of them.
FactorsT = TypeVar('FactorsT', bound=Factors)
Row = tuple[int, int, Array, Array]


def stacked(kind: type[FactorsT], rows: Iterable[Row]) -> FactorsT:
    """Return factors of one kind from their rows."""
    rows, d = [*rows], kind.DIMENSION
    return kind(
        np.array([row[0] for row in rows], np.intp), np.array([row[1] for row in rows], np.intp),
        np.array([row[2] for row in rows]).reshape(-1, d),
        np.array([row[3] for row in rows]).reshape(-1, d, d))


def shifted(factors: FactorsT, poses: int) -> FactorsT:
    """Return factors between poses whose indices are larger by a number of poses."""
    return replace(factors, pose=factors.pose + poses, target=factors.target + poses)


def concatenated(*parts: FactorsT) -> FactorsT:
    """Return factors of one kind as one, in the same order, with one covariance each."""
    R = [np.broadcast_to(part.R, (len(part.z), *part.R.shape[-2:])) for part in parts]
    return type(parts[0])(
        np.concatenate([part.pose for part in parts]),
        np.concatenate([part.target for part in parts]),
        np.concatenate([part.z for part in parts]), np.concatenate(R))


NO_RENDEZVOUS = stacked(RendezvousFactors, ())


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All measurements."""

    #: odometry, landmarks, rendezvous: the factors
    odometry: OdometryFactors
    landmarks: LandmarkFactors
    rendezvous: RendezvousFactors = NO_RENDEZVOUS
    #: indices of the poses that keep their initial values, one for each group of connected robots
    fixed_poses: Sequence[int] = (0,)
    #: what `system` has returned, by the numbers of variables
    _systems: 'dict[tuple[int, int], System]' = field(
        default_factory=dict, init=False, repr=False)

    def __reduce__(self) -> tuple[object, ...]:
        return Problem, (self.odometry, self.landmarks, self.rendezvous, self.fixed_poses)

    def system(self, x: Values, kept: Sequence[int] = ()) -> 'System':
        """
        Return the normal equations of variables x; their order and pattern are found once.

        Poses with odometry only are eliminated, but for those `kept`, for which they are found
        again each time.

        """
        sizes = len(x.poses), len(x.points)
        if len(kept):
            return System(self, *sizes, kept)
        if sizes not in self._systems:
            self._systems[sizes] = System(self, *sizes)
        return self._systems[sizes]

    def forget_systems(self) -> None:
        """Free the memory of what `system` has found, some kB for each measurement."""
        self._systems.clear()


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A minimum of the cost."""

    values: Values  #: poses and landmarks at the minimum
    cost: float  #: chi-square, if Q and R are the covariances of the measurements
    unknowns: int  #: number of coordinates solved for
    iterations: int  #: number of steps
    rejected: int  #: number of steps that would have raised the cost and were damped instead


def solve(
    problem: Problem, start: Values, tolerance: float = TOLERANCE, max_iterations: int = 100,
    loss: CauchyLoss | None = None,
) -> Solution:
    """
    Return the minimum that damped Gauss-Newton reaches from a start.

    The minimum need not be the global one: far from the truth it depends on the start. Where a
    robot turns once more than its odometry, between two poses with other measurements, the
    iteration goes on without that turn, and the lower minimum counts.

    Parameters
    ----------
    problem : the measurements, at least one
    start : initial values
    tolerance : largest increment of a coordinate at the end [m, rad]
    max_iterations : maximum number of steps
    loss : cost of landmark observations, None for squares

    Raises
    ------
    SingularError, ConvergenceError
        The measurements do not determine all variables; the start is too far away.

    """
    system, damping = copy(problem.system(start)), NielsenDamping()
    system.tolerance, system.loss = tolerance, loss
    values, _, iterations = gauss_newton(system, start, max_iterations, damping)
    cost, unwound = system.linearize(values).cost, system.unwound(values)
    if unwound is not None:
        other, _, more = gauss_newton(system, unwound, max_iterations, damping)
        iterations += more
        if (other_cost := system.linearize(other).cost) < cost:
            values, cost = other, other_cost
    return Solution(values, cost, system.unknowns, iterations, damping.rejected)


def information(
    problem: Problem, values: Values, kept: Sequence[int] | None = None
) -> Information:
    """
    Return the information, linearised at some values; errors as of `Information`.

    Poses with odometry only are eliminated, but for those `kept`; None keeps all.

    """
    return problem.system(
        values, range(len(values.poses)) if kept is None else kept).information(values)


def chi_square(problem: Problem, values: Values) -> float:
    """Return the cost of a problem at some values."""
    return problem.system(values).linearize(values).cost


@dataclass(frozen=True, slots=True, eq=False)
class LinearizedFactors:
    """Whitened A (m, d, c) and b (m, d) of each kind of factors, that of chains first."""

    A: list[Array]
    b: list[Array]
    chains: ReducedChains
    cost: float
    #: decrease of the cost if only the poses within chains move
    within_chains: float


class System:
    """
    Eq. (2) of [Andersson]: the steps of `gauss_newton` on a sparse problem.

    Parameters
    ----------
    problem : all measurements
    poses, points : number of poses and of landmarks
    kept : poses that are not eliminated, even if there is only odometry to them

    Attributes
    ----------
    tolerance : largest increment of a coordinate at the end of the iteration [m, rad]
    loss : cost of landmark observations, None for squares
    unknowns : number of coordinates that are solved for, eliminated ones included

    """

    def __init__(
        self, problem: Problem, poses: int, points: int, kept: Sequence[int] = ()
    ) -> None:
        self.tolerance = TOLERANCE
        self.loss: CauchyLoss | None = None
        # Factor of A^T A that the next step may use, and the size of the last step. It belongs to
        # one iteration: `solve` copies the system, which others use as well.
        self._last_factor: tuple[Cholesky, float] | None = None
        odometry, *others = problem.odometry, problem.landmarks, problem.rendezvous
        needed = np.zeros(poses, bool)
        for used in (
                kept, problem.fixed_poses, problem.landmarks.pose, problem.rendezvous.pose,
                problem.rendezvous.target):
            needed[np.array(used, np.intp)] = True
        self._chains = OdometryChains.of(odometry.pose, odometry.target, needed)
        chained = rows_of(odometry, self._chains.rows)
        self._chained = ChainedIncrements.of(self._chains, chained.z, chained.R)
        single = np.delete(np.arange(len(odometry.z)), self._chains.rows)
        if len(self._chains.rows):
            odometry = rows_of(odometry, single)
        self._factors = [factors for factors in (odometry, *others) if len(factors.z) > 0]
        self._whiteners = [whitener(factors.R) for factors in self._factors]
        free = np.ones(poses + points, bool)
        free[list(problem.fixed_poses)] = False
        free[self._chains.eliminated] = False
        links = [factors.nodes(poses) for factors in self._factors]
        if len(self._chains.rows):
            links.insert(0, self._chains.nodes)
        self._equations = NormalEquations(
            np.repeat([3, 2], [poses, points]), np.flatnonzero(free), links)
        self.unknowns = len(self._equations.coordinates) + 3 * len(self._chains.eliminated)
        self._poses, self._points = poses, points

    def information(self, x: Values) -> Information:
        """Return the information linearised at x; errors as of `Information`."""
        at = self.linearize(x)
        return Information(
            self._equations.matrix(at.A), self._equations.coordinates, self._poses, self._points,
            at.chains)

    def unwound(self, x: Values) -> Values | None:
        """Return values without turns that contradict odometry, None if there are none."""
        poses = self._chained.unwound(x.poses)
        return None if poses is None else Values(poses, x.points)

    def linearize(self, x: Values) -> LinearizedFactors:
        A, b, cost = [], [], 0.0
        for factors, L_inv in zip(self._factors, self._whiteners):
            H, r = factors.linearize(x)
            A_k, b_k = L_inv @ H, (L_inv @ r[:, :, None])[:, :, 0]
            if self.loss is not None and isinstance(factors, LandmarkFactors):
                d2 = np.square(b_k).sum(axis=1)
                root = np.sqrt(self.loss.weights(d2))
                A_k, b_k = A_k * root[:, None, None], b_k * root[:, None]
                cost += self.loss.cost(d2)
            else:
                cost += float(np.vdot(b_k, b_k))
            A.append(A_k)
            b.append(b_k)
        chains, within = self._chained.reduced(x.poses), 0.0
        if len(chains.Phi):
            L_inv = whitener(chains.covariances)
            A.insert(0, L_inv @ chains.H)
            b.insert(0, (L_inv @ chains.residuals[:, :, None])[:, :, 0])
            cost += chains.cost
            within = chains.cost - float(np.vdot(b[0], b[0]))
        return LinearizedFactors(A, b, chains, cost, within)

    def step(self, at: LinearizedFactors, damping: float) -> tuple[Array, float]:
        """
        Solve (A^T A + damping diag(A^T A)) dx = A^T b.

        After a small step, A^T A is that of the step before: it has hardly changed, and the
        minimum is where A^T b is zero. Within chains, poses move with the ends, and by a share of
        the way to their best places.

        """
        g, reused = self._equations.right_side(at.A, at.b), self._last_factor
        if damping > 0.0 or reused is None:
            N = self._equations.matrix(at.A)
            D = damping * N.diagonal()
            factor, size_before = Cholesky(N + diagonal(D) if damping > 0.0 else N), np.inf
        else:
            D, (factor, size_before) = np.zeros(len(g)), reused
        dx_free = factor.solve(g)
        size = float(np.abs(dx_free).max(initial=0.0))
        is_reusable = damping == 0.0 and size < min(MAX_REUSE_STEP, MAX_REUSE_RATIO * size_before)
        self._last_factor = (factor, size) if is_reusable else None
        dx = np.zeros(3 * self._poses + 2 * self._points)
        dx[self._equations.coordinates] = dx_free
        share = 1.0 / (1.0 + damping)
        at.chains.correct(dx[:3 * self._poses].reshape(-1, 3), share)
        within = (1.0 - (1.0 - share) ** 2) * at.within_chains
        return dx, float(dx_free @ (g + D * dx_free)) + within

    def retract(self, x: Values, dx: Array) -> Values:
        dx_poses, dx_points = np.split(dx, [x.poses.size])
        return Values(poses_plus(x.poses, dx_poses), x.points + dx_points.reshape(-1, 2))

    def has_converged(self, x: Values, dx: Array, decrease: float) -> bool:
        return bool(np.abs(dx).max(initial=0.0) < self.tolerance)


def rows_of(factors: FactorsT, rows: Indices) -> FactorsT:
    """Return some of the factors, with one covariance each."""
    R = np.broadcast_to(factors.R, (len(factors.z), *factors.R.shape[-2:]))
    return replace(
        factors, pose=factors.pose[rows], target=factors.target[rows], z=factors.z[rows],
        R=R[rows])


def whitener(R: Array) -> Array:
    """
    Return L^-1 of the covariance R = L L^T, one (d, d) or several (k, d, d).

    Raises
    ------
    SingularError
        If a covariance is not positive definite within rounding.

    """
    try:
        L = np.linalg.cholesky(R)
    except np.linalg.LinAlgError:
        raise SingularError('the covariance of a measurement is singular') from None
    # numpy 1.26 takes a single identity for vectors where R is a stack.
    return np.linalg.solve(L, np.broadcast_to(np.eye(R.shape[-1]), R.shape))
