# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Batch least squares beside other solvers: the same measurements from the same start.

The others use Levenberg-Marquardt with its defaults, and end once the cost falls by less than
`RELATIVE_DECREASE`; ours ends at increments of 1e-9, as always. Each has one thread.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.factors import Values
from fej_slam_ros.core.smoothing.least_squares import chi_square
from fej_slam_ros.core.smoothing.problem import Problem

OUR_BATCH = 'fej_slam_ros'
RELATIVE_DECREASE = 1e-9
MAX_ITERATIONS = 100


@dataclass(frozen=True)
class TimedSolution:
    """A solution, and the time to it."""

    values: Values
    seconds: float
    iterations: int


#: Solves a problem from a start.
Solver = Callable[[Problem, Values], TimedSolution]


@dataclass(frozen=True)
class BatchTime:
    """A solution by one solver."""

    name: str  #: Of the data
    solver: str
    unknowns: int  #: Number of unknown coordinates
    seconds: float
    iterations: int
    cost: float  #: Our chi-square at its solution
    difference: float  #: Largest distance of a pose from ours [m]


def batch_times(
    name: str, problem: Problem, start: Values, others: Mapping[str, Solver]
) -> list[BatchTime]:
    """Time our solver and others on a problem without robot-to-robot observations."""
    solutions = {OUR_BATCH: solve(problem, start)} | {
        solver: solve_by(problem, start) for solver, solve_by in others.items()}
    ours = solutions[OUR_BATCH].values
    unknowns = 3 * (len(start.poses) - len(problem.fixed_poses)) + 2 * len(start.points)
    return [
        BatchTime(
            name, solver, unknowns, found.seconds, found.iterations,
            chi_square(problem, found.values),
            float(np.hypot(*(found.values.poses - ours.poses)[:, :2].T).max()))
        for solver, found in solutions.items()]


def solve(problem: Problem, start: Values) -> TimedSolution:
    """Return the solution of this package, and the time to it."""
    problem.forget_systems()
    begin = perf_counter()
    solution = least_squares.solve(problem, start)
    return TimedSolution(solution.values, perf_counter() - begin, solution.iterations)
