# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Least squares over all poses of all robots and all landmarks, in one frame.

The cost of poses x = [p, phi] and landmarks f is

    sum |u - x_begin^-1 o x_end|^2_Q + sum |z - C(phi)^T (f - p)|^2_R
    + sum |z - C(phi)^T (p_observed - p)|^2_R,    |r|^2_Q = r^T Q^-1 r,

with heading residuals wrapped. The first two sums are eq. (1) of [Andersson], and the batch
solution of eqs. (2) and (7) of [Liu]; with the third it is eq. (21) of [Andersson], whose base
node is the first pose of the other robot. Consecutive indices along each trajectory are fastest.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.gauss_newton import gauss_newton, NielsenDamping, NoMinimumError
from fej_slam_ros.core.geometry import Array, poses_plus
from fej_slam_ros.core.smoothing.cauchy_loss import CauchyLoss
from fej_slam_ros.core.smoothing.factors import Values
from fej_slam_ros.core.smoothing.marginals import Information
from fej_slam_ros.core.smoothing.normal_equations import Cholesky, diagonal
from fej_slam_ros.core.smoothing.problem import LinearizedFactors, Problem, System

#: Largest increment of a coordinate at the minimum [m, rad].
TOLERANCE = 1e-9
#: Largest increment [m, rad] after which the factor of A^T A is used again, and its largest ratio
#: to the one before, if that was found with the same factor: otherwise it converges too slowly.
MAX_REUSE_STEP, MAX_REUSE_RATIO = 1e-3, 0.2


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
    iteration goes on without that turn, and the lower minimum counts, or the first if there is no
    other.

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
    system, damping = problem.system(start), NielsenDamping()
    values, _, iterations = gauss_newton(
        Minimization(system, tolerance, loss), start, max_iterations, damping)
    cost, unwound = system.linearize(values, loss).cost, system.unwound(values)
    if unwound is not None:
        with suppress(NoMinimumError):
            other, _, more = gauss_newton(
                Minimization(system, tolerance, loss), unwound, max_iterations, damping)
            iterations += more
            if (other_cost := system.linearize(other, loss).cost) < cost:
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


class Minimization:
    """
    The steps of `gauss_newton`.

    Parameters
    ----------
    system : the normal equations
    tolerance : largest increment of a coordinate at the end [m, rad]
    loss : cost of landmark observations, None for squares

    """

    def __init__(self, system: System, tolerance: float, loss: CauchyLoss | None) -> None:
        self._system, self._tolerance, self._loss = system, tolerance, loss
        # Factor of A^T A that the next step may use, and the size of the last step.
        self._last_factor: tuple[Cholesky, float] | None = None

    def linearize(self, x: Values) -> LinearizedFactors:
        return self._system.linearize(x, self._loss)

    def step(self, at: LinearizedFactors, damping: float) -> tuple[Array, float]:
        """
        Solve (A^T A + damping diag(A^T A)) dx = A^T b.

        After a small step, A^T A is that of the step before: it has hardly changed, and the
        minimum is where A^T b is zero.

        """
        equations = self._system.equations
        g, reused = equations.right_side(at.A, at.b), self._last_factor
        if damping > 0.0 or reused is None:
            N = equations.matrix(at.A)
            D = damping * N.diagonal()
            factor, size_before = Cholesky(N + diagonal(D) if damping > 0.0 else N), np.inf
        else:
            D, (factor, size_before) = np.zeros(len(g)), reused
        dx_free = factor.solve(g)
        size = float(np.abs(dx_free).max(initial=0.0))
        is_reusable = damping == 0.0 and size < min(MAX_REUSE_STEP, MAX_REUSE_RATIO * size_before)
        self._last_factor = (factor, size) if is_reusable else None
        share = 1.0 / (1.0 + damping)
        within = (1.0 - (1.0 - share) ** 2) * at.within_chains
        return (
            self._system.correction(at, dx_free, share),
            float(dx_free @ (g + D * dx_free)) + within)

    def retract(self, x: Values, dx: Array) -> Values:
        dx_poses, dx_points = np.split(dx, [x.poses.size])
        return Values(poses_plus(x.poses, dx_poses), x.points + dx_points.reshape(-1, 2))

    def has_converged(self, x: Values, dx: Array, decrease: float) -> bool:
        return bool(np.abs(dx).max(initial=0.0) < self._tolerance)
