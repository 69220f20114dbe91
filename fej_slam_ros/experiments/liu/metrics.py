# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The entries of Tables 1 and 2 of [Liu], and their variation by chance.

RMSE is the mean over steps (or landmarks) of the root mean square over runs, NEES the mean over
both; landmarks count at the last step only. The RMSE of a single run is the root mean square over
its steps (or landmarks), so that runs are a sample and their mean has a confidence interval.
"""

from dataclasses import dataclass
import math

import numpy as np
from scipy.special import stdtrit

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.experiments.liu.configurations import EntryRange, TABLE_ENTRIES
from fej_slam_ros.experiments.liu.monte_carlo import Errors

#: Number of runs behind an entry of the paper's tables.
RUNS_PER_ENTRY = 100
RESAMPLES = 2000


def entries(errors: Errors) -> dict[str, float]:
    """Return the entries of stacked runs."""
    runs = len(errors.landmarks)
    weighted = _weighted(errors, np.full((1, runs), 1.0 / runs))
    return {name: float(values[0]) for name, values in weighted.items()}


def ranges(errors: Errors, rng: np.random.Generator) -> dict[str, EntryRange]:
    """Return the distribution of the entries, by resampling 100 of the stacked runs."""
    runs = len(errors.landmarks)
    weights = rng.multinomial(RUNS_PER_ENTRY, np.full(runs, 1.0 / runs), RESAMPLES)
    quantiles = 0.025, 0.975, 0.0015, 0.9985
    return {
        name: EntryRange(*map(float, (
            np.mean(values), np.std(values), *np.quantile(values, quantiles))))
        for name, values in _weighted(errors, weights / RUNS_PER_ENTRY).items()}


def entries_of_run(errors: Errors) -> dict[str, float]:
    """Return NEES and root mean square errors of one run over its steps, or landmarks."""
    values: list[float] = []
    for steps in errors.poses.values():
        position, heading, nees = steps.mean(axis=1).tolist()
        values += [nees, math.sqrt(position), math.sqrt(heading)]
    position, nees = errors.landmarks.mean(axis=1).tolist()
    return dict(zip(TABLE_ENTRIES, [*values, nees, math.sqrt(position)]))


def entries_of_each(errors: Errors) -> list[dict[str, float]]:
    """Return the entries of each of the stacked runs alone, as `entries_of_run`."""
    return [
        entries_of_run(Errors({name: steps[k] for name, steps in errors.poses.items()}, landmarks))
        for k, landmarks in enumerate(errors.landmarks)]


@dataclass(frozen=True, slots=True)
class SampleMean:
    """Mean over independent runs."""

    value: float  #: The mean
    runs: int  #: Number of runs
    error: float | None  #: Its standard error, None for a single run
    #: Half the width of its 95 % confidence interval by Student's t, None for a single run.
    margin: float | None


def sample_mean(values: Array) -> SampleMean:
    """Return the mean of the values (n,) of n runs."""
    value, runs = float(np.mean(values)), len(values)
    if runs == 1:
        return SampleMean(value, runs, None, None)
    error = float(np.std(values, ddof=1)) / math.sqrt(runs)
    return SampleMean(value, runs, error, error * float(stdtrit(runs - 1, 0.975)))


@dataclass(frozen=True, slots=True, eq=False)
class ErrorCurves:
    """NEES/3, position RMSE [m] and heading RMSE [rad] over runs at the last K steps, (K,)."""

    nees: Array
    position: Array
    heading: Array


def error_curves(errors: Errors) -> dict[str, ErrorCurves]:
    """Return the errors of each robot step by step, Figures 4 and 5 of [Liu]."""
    means = {name: steps.mean(axis=0) for name, steps in errors.poses.items()}
    return {
        name: ErrorCurves(nees, np.sqrt(position), np.sqrt(heading))
        for name, (position, heading, nees) in means.items()}


def _weighted(errors: Errors, weights: Array) -> dict[str, Array]:
    """Return the entries (B,) for weights (B, runs) of the runs; each row sums to 1."""
    values: list[Array] = []
    for steps in errors.poses.values():
        values += [weights @ steps[:, 2].mean(axis=1), *(
            _mean_root(weights, steps[:, axis]) for axis in (0, 1))]
    values += [
        weights @ errors.landmarks[:, 1].mean(axis=1),
        _mean_root(weights, errors.landmarks[:, 0])]
    return dict(zip(TABLE_ENTRIES, values))


def _mean_root(weights: Array, squares: Array) -> Array:
    mean: Array = np.sqrt(weights @ squares).mean(axis=1)
    return mean
