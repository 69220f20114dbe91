# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Gauss-Newton iteration for nonlinear least squares, optionally damped.

Used by step 0 of the filter, eq. (12) of [Liu], by the smoother, eq. (2) of [Andersson], and by
the alignment of two maps, Algorithm 1 of [Andersson].
"""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from fej_slam_ros.core.geometry import Array

#: An increase of the cost by less than this fraction is attributed to rounding.
COST_ROUNDING = 1e-12
#: Smallest damping other than zero, as a fraction of the diagonal of A^T A.
MIN_DAMPING = 1e-6

X = TypeVar('X')
L = TypeVar('L')
L_contra = TypeVar('L_contra', contravariant=True)


class NoMinimumError(ArithmeticError):
    """A least-squares problem was not solved."""


class ConvergenceError(NoMinimumError):
    """The iteration did not converge: the start is too far from a minimum."""


class SingularError(NoMinimumError):
    """The measurements do not determine all unknowns."""


class LeastSquares(Protocol[X, L]):
    """Minimisation of |r(x)|^2 over x in X; L holds r(x + dx) ~ b - A dx, whitened."""

    def linearize(self, x: X) -> L:
        """Return A and b at x."""

    def step(self, at: L, damping: float) -> tuple[Array, float]:
        """Return the increment dx that minimises |b - A dx|^2 and the predicted decrease."""

    def retract(self, x: X, dx: Array) -> X:
        """Return x moved by dx."""

    def has_converged(self, x: X, dx: Array, decrease: float) -> bool:
        """Return whether the step dx that led to x is the last one."""


class HasCost(Protocol):
    """Linearisation that knows the cost |r(x)|^2."""

    @property
    def cost(self) -> float:
        """Return the cost."""


class Damping(Protocol[L_contra]):
    """Rule that accepts steps; `value` times the diagonal of A^T A is added to it."""

    value: float

    def accepts(self, before: L_contra, after: L_contra, decrease: float) -> bool:
        """Return whether a step is taken, and set the damping of the next one."""


class Undamped:
    """Plain Gauss-Newton: every step is taken."""

    value = 0.0

    def accepts(self, before: object, after: object, decrease: float) -> bool:
        """Return True."""
        return True


class NielsenDamping:
    """
    Nielsen's rule, but zero until a step fails and zero again once it is small.

    Attributes
    ----------
    value : fraction of the diagonal of A^T A that is added to it
    rejected : number of failed steps

    """

    def __init__(self) -> None:
        self.value, self.rejected = 0.0, 0
        self._growth = 2.0

    def accepts(self, before: HasCost, after: HasCost, decrease: float) -> bool:
        """Return whether a step lowered the cost, and set the damping of the next one."""
        if after.cost > before.cost * (1.0 + COST_ROUNDING):
            self.rejected += 1
            self.value = max(self._growth * self.value, MIN_DAMPING)
            self._growth *= 2.0
            return False
        if self.value > 0.0:
            gain = (before.cost - after.cost) / decrease
            self.value *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
            self._growth = 2.0
            # Rounding hides the gain of the last steps.
            if self.value < MIN_DAMPING or decrease < COST_ROUNDING * before.cost:
                self.value = 0.0
        return True


@dataclass(frozen=True, slots=True, eq=False)
class Minimum(Generic[X, L]):
    """The minimum x, the linearisation that the last step started from, and the step count."""

    x: X
    linearized: L
    iterations: int


def gauss_newton(
    problem: LeastSquares[X, L], start: X, max_iterations: int, damping: Damping[L] | None = None
) -> Minimum[X, L]:
    """
    Return the minimum that the iteration reaches from a start.

    Raises
    ------
    ConvergenceError
        The iteration did not end within `max_iterations` steps.
    SingularError
        The measurements do not determine all unknowns.

    """
    rule = damping or Undamped()
    x, at = start, problem.linearize(start)
    for iteration in range(1, max_iterations + 1):
        dx, decrease = problem.step(at, rule.value)
        x_next = problem.retract(x, dx)
        if rule.value == 0.0 and problem.has_converged(x_next, dx, decrease):
            return Minimum(x_next, at, iteration)
        next_at = problem.linearize(x_next)
        if rule.accepts(at, next_at, decrease):
            x, at = x_next, next_at
    raise ConvergenceError(f'least squares did not converge in {max_iterations} iterations')
