# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Gauss-Newton iteration for nonlinear least squares, optionally damped.

Used by step 0 of the filter, eq. (12) of [Liu], by the smoother, eq. (2) of [Andersson], and by
the alignment of two maps, Algorithm 1 of [Andersson].
"""

from typing import Protocol, TypeVar

from fej_slam_ros.core.geometry import Array

#: An increase of the cost by less than this fraction is attributed to rounding.
COST_ROUNDING = 1e-12
#: So is one by less than this fraction after an undamped step of which no larger decrease is
#: predicted: precise measurements of large coordinates round the cost by so much.
MAX_COST_ROUNDING = 1e-9
#: Smallest damping other than zero, as a fraction of the diagonal of A^T A.
MIN_DAMPING = 1e-6

X = TypeVar('X')


class NoMinimumError(ArithmeticError):
    """A least-squares problem was not solved."""


class ConvergenceError(NoMinimumError):
    """The iteration did not converge: the start is too far from a minimum."""


class SingularError(NoMinimumError):
    """The measurements do not determine all unknowns."""


class Linearized(Protocol):
    """Whitened linearisation of a cost, |r(x + dx)|^2 ~ |b - A dx|^2."""

    @property
    def cost(self) -> float:
        """Return |r(x)|^2."""


L = TypeVar('L', bound=Linearized)


class LeastSquares(Protocol[X, L]):
    """Minimisation of |r(x)|^2."""

    def linearize(self, x: X) -> L:
        """Return the linearisation at x."""

    def step(self, at: L, damping: float) -> tuple[Array, float]:
        """Return the dx that minimises |b - A dx|^2, and the predicted decrease of the cost."""

    def retract(self, x: X, dx: Array) -> X:
        """Return x moved by dx, with headings wrapped."""

    def has_converged(self, x: X, dx: Array, decrease: float) -> bool:
        """Return whether the step dx that led to x is the last one."""


class NielsenDamping:
    """Nielsen's rule, but zero until a step fails and zero again once it is small."""

    def __init__(self) -> None:
        self.value = 0.0  #: fraction of the diagonal of A^T A that is added to it
        self.rejected = 0  #: number of failed steps
        self._growth = 2.0

    def accepts(self, before: float, after: float, decrease: float) -> bool:
        """Return whether a step lowered the cost, and set the damping of the next one."""
        is_last = self.value == 0.0 and decrease < MAX_COST_ROUNDING * before
        if after > before * (1.0 + (MAX_COST_ROUNDING if is_last else COST_ROUNDING)):
            self.rejected += 1
            self.value = max(self._growth * self.value, MIN_DAMPING)
            self._growth *= 2.0
            return False
        if self.value > 0.0:
            gain = (before - after) / decrease
            self.value *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
            self._growth = 2.0
            # Rounding hides the gain of the last steps.
            if self.value < MIN_DAMPING or decrease < COST_ROUNDING * before:
                self.value = 0.0
        return True

    def end(self) -> None:
        """Damp no more until a step fails again."""
        self.value, self._growth = 0.0, 2.0


def gauss_newton(
    problem: LeastSquares[X, L], x: X, max_iterations: int, damping: NielsenDamping | None = None
) -> tuple[X, L, int]:
    """
    Return the minimum reached from x, the last linearisation, and the number of steps.

    An undamped step that raises the cost is taken together with another one, as one step, if that
    lowers it: along a narrow, curved valley, as of a robot that hardly slips sideways, the first
    leaves the valley and the second returns to it, while damped steps hardly move.

    Raises
    ------
    ConvergenceError, SingularError
        `max_iterations` steps were not enough; the measurements do not determine all unknowns.

    """
    at = problem.linearize(x)
    for iteration in range(1, max_iterations + 1):
        value = damping.value if damping else 0.0
        dx, decrease = problem.step(at, value)
        x_next = problem.retract(x, dx)
        if value == 0.0 and problem.has_converged(x_next, dx, decrease):
            return x_next, at, iteration
        next_at = problem.linearize(x_next)
        if damping is None or damping.accepts(at.cost, next_at.cost, decrease):
            x, at = x_next, next_at
        elif value == 0.0:
            x_after, after = _another_step(problem, x_next, next_at)
            if after.cost < at.cost:
                x, at = x_after, after
                damping.end()
    raise ConvergenceError(f'least squares did not converge in {max_iterations} iterations')


def _another_step(problem: LeastSquares[X, L], x: X, at: L) -> tuple[X, L]:
    """Return where an undamped step from x leads, or x itself if there is none."""
    try:
        dx, _ = problem.step(at, 0.0)
    except SingularError:
        return x, at
    x_next = problem.retract(x, dx)
    return x_next, problem.linearize(x_next)
