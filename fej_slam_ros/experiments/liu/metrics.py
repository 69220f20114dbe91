# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The entries of Tables 1 and 2 of [Liu], and how much chance is in them.

RMSE is the mean over steps (or landmarks) of the root of the mean over runs, NEES the mean over
both; landmarks count at the last step only. A run by itself has the root mean square over its
steps (or landmarks) instead, which makes runs a sample: their mean has an interval.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
from scipy.special import stdtrit

from fej_slam_ros.core.chi_square import chi_square_band
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.experiments.liu.configurations import ENTRIES, PublishedRange
from fej_slam_ros.experiments.liu.monte_carlo import Errors

#: An entry of the paper's tables is made of so many runs.
RUNS = 100
RESAMPLES = 2000


def entries(errors: Errors) -> dict[str, float]:
    """Return the entries that stacked runs give."""
    runs = len(errors.landmarks)
    weighted = _weighted(errors, np.full((1, runs), 1.0 / runs))
    return {name: float(values[0]) for name, values in weighted.items()}


def entries_of_each(errors: Errors) -> dict[str, Array]:
    """Return the entries that each of the stacked runs gives alone."""
    return _weighted(errors, np.eye(len(errors.landmarks)))


def ranges(errors: Errors, rng: np.random.Generator) -> dict[str, PublishedRange]:
    """Return what chance does to the entries, by drawing 100 of the stacked runs many times."""
    runs = len(errors.landmarks)
    weights = rng.multinomial(RUNS, np.full(runs, 1.0 / runs), RESAMPLES) / RUNS
    quantiles = 0.025, 0.975, 0.0015, 0.9985
    return {
        name: PublishedRange(*map(float, (
            np.mean(values), np.std(values), *np.quantile(values, quantiles))))
        for name, values in _weighted(errors, weights).items()}


def entries_of_run(errors: Errors) -> dict[str, float]:
    """Return NEES and root mean square errors of one run over its steps, or landmarks."""
    found: list[float] = []
    for steps in errors.poses.values():
        position, heading, nees = steps.mean(axis=1).tolist()
        found += [nees, math.sqrt(position), math.sqrt(heading)]
    position, nees = errors.landmarks.mean(axis=1).tolist()
    return dict(zip(ENTRIES, [*found, nees, math.sqrt(position)]))


@dataclass(frozen=True, slots=True)
class Mean:
    """
    A mean over independent runs.

    Attributes
    ----------
    value : the mean
    runs : how many they are
    error : its standard error, None for a single run
    margin : half the width of its 95 % confidence interval by Student's t, likewise

    """

    value: float
    runs: int
    error: float | None
    margin: float | None


def mean(values: Array) -> Mean:
    """Return the mean of values (n,) of n runs."""
    value, runs = float(np.mean(values)), len(values)
    if runs == 1:
        return Mean(value, runs, None, None)
    error = float(np.std(values, ddof=1)) / math.sqrt(runs)
    return Mean(value, runs, error, error * float(stdtrit(runs - 1, 0.975)))


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """NEES / 3, position RMSE [m] and heading RMSE [rad] over runs at the last K steps, (K,)."""

    nees: Array
    position: Array
    heading: Array


def courses(errors: Errors) -> dict[str, Course]:
    """Return how each robot's entries came about, Figures 4 and 5 of [Liu]."""
    return {
        name: Course(of[2], np.sqrt(of[0]), np.sqrt(of[1]))
        for name, of in ((name, steps.mean(axis=0)) for name, steps in errors.poses.items())}


def root_mean_square(errors: Array) -> float:
    """Return sqrt(mean |e|^2) over errors (k, d), NaN where there are none."""
    return math.sqrt(np.mean(np.sum(errors**2, axis=1))) if len(errors) else math.nan


def nees_band(runs: int, probability: float = 0.95) -> tuple[float, float]:
    """Return where the mean NEES / 3 of runs of a consistent filter lies at a step."""
    low, high = chi_square_band(3 * runs, probability)
    return low / (3 * runs), high / (3 * runs)


def _weighted(errors: Errors, weights: Array) -> dict[str, Array]:
    """Return the entries (B,) for weights (B, runs) of the runs, rows of which add up to 1."""
    return dict(zip(ENTRIES, _in_order(errors, weights)))


def _in_order(errors: Errors, weights: Array) -> Iterator[Array]:
    for steps in errors.poses.values():
        yield _mean(weights, steps[:, 2])
        yield _mean_root(weights, steps[:, 0])
        yield _mean_root(weights, steps[:, 1])
    yield _mean(weights, errors.landmarks[:, 1])
    yield _mean_root(weights, errors.landmarks[:, 0])


def _mean(weights: Array, values: Array) -> Array:
    mean: Array = weights @ values.mean(axis=1)
    return mean


def _mean_root(weights: Array, squares: Array) -> Array:
    mean: Array = np.sqrt(weights @ squares).mean(axis=1)
    return mean
