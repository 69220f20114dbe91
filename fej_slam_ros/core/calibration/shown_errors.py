# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which systematic errors the data show.

A robot that drives straight shows no error of turns: a fit of all errors would be wrong by the
noise. Errors that the data do not show are therefore taken out of the fit one by one.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.geometry import Array, Flags, Indices, Stamps
from fej_slam_ros.core.records import NS

#: Minimum number of observations, or of pairs of them, for a fit.
MIN_FIT_PAIRS = 60
#: Length [ns] of the blocks within which residuals count as dependent, since pairs share odometry,
#: and minimum number of blocks.
BLOCK_TIME, MIN_BLOCKS = 10 * NS, 10
#: Minimum number of standard errors of an error.
MIN_SIGMAS = 4.0
#: Gain of the log-likelihood by an error from which there is one: of three standard deviations,
#: 4.5, for errors that persist over ten observations.
MIN_GAIN = 45.0


class ErrorLimits(NamedTuple):
    """Limits of n kinds of errors."""

    none: Array  #: (n,) array, the values without errors
    #: (n,) array; these standard deviations keep a value at `none` that the data leave open
    prior_sigma: Array
    #: (n,) array; a value is determined below this, an error below twice this
    max_standard_error: Array
    min_error: Array  #: (n,) array; errors are larger, and larger than MIN_SIGMAS standard errors

    @property
    def max_error(self) -> Array:
        """Return the largest differences (n,) from `none` that are searched."""
        return 3.0 * self.prior_sigma

    def judged(self, x: Array, sigma: Array) -> tuple[Flags, Flags, Flags]:
        """Return which values (n,) are known, which of them are errors, and which at a limit."""
        error = np.abs(x - self.none)
        at_limit = error > 0.99 * self.max_error
        is_error = ~at_limit & (error > np.maximum(MIN_SIGMAS * sigma, self.min_error))
        shown = is_error & (sigma < 2.0 * self.max_standard_error)
        return shown | (~at_limit & (sigma < self.max_standard_error)), shown, at_limit


@dataclass(frozen=True, slots=True, eq=False)
class ErrorFit:
    """A fit of n errors and perhaps of more values x (m,), which follow the errors."""

    x: Array
    information: Array  #: (m, m) array about all of them, perhaps not symmetric
    gradients: Array  #: (k, m) array, of half the robust cost of each residual
    weights: Array  #: (k, m) array, the information of each residual about each value
    scatter: float  #: standard deviation of the residuals

    def standard_errors(self, block: Indices) -> tuple[Array, Array]:
        """
        Return those (m,) for independent pairs, and the larger ones that blocks show.

        Where a robot stands still, its blocks have no information about the errors of driving:
        the latter are huge where three blocks or fewer have nearly all of it.

        """
        P = np.linalg.inv(self.information)
        of_independent = np.sqrt(np.abs(np.diag(P))) * self.scatter
        gradients, weights = (
            _of_blocks(values, block) for values in (self.gradients, self.weights))
        # The mean is 0 but where an error is at its limit.
        gradients -= gradients.mean(axis=0)
        # As many blocks of equal information would have the same scatter.
        squares = np.square(weights).sum(axis=0)
        count = np.square(weights.sum(axis=0)) / np.where(squares > 0.0, squares, 1.0)
        of_blocks = np.sqrt(
            np.diag(P @ gradients.T @ gradients @ P.T) * count / np.maximum(count - 3.0, 1e-9))
        return of_independent, np.maximum(of_independent, of_blocks)


def _of_blocks(values: Array, block: Indices) -> Array:
    """Return the sums (b, m) over the pairs of each block; values (k, m) are of the residuals."""
    m = values.shape[1]
    sums = np.zeros((block.max() + 1, m))
    np.add.at(sums, block, values.reshape(len(block), -1, m).sum(axis=1))
    return sums


def blocks(stamps: Stamps) -> Indices:
    """Return the number (n,) of the block of each pair, from its stamp (n,) [ns]."""
    return np.unique(stamps // BLOCK_TIME, return_inverse=True)[1]


def suffice(stamps: Stamps) -> bool:
    """Return whether pairs at stamps (n,) [ns] are enough for a fit, and in enough blocks."""
    return len(stamps) >= MIN_FIT_PAIRS and len(np.unique(stamps // BLOCK_TIME)) >= MIN_BLOCKS


@dataclass(frozen=True, slots=True, eq=False)
class ErrorEstimate:
    """Estimate of n errors."""

    values: Array  #: (n,) array; the given values where the data do not determine them
    sigma: Array  #: (n,) array, standard errors of a fit of all of them
    is_known: Flags  #: (n,) array, whether the data determine the value, perhaps as no error
    is_at_limit: Flags  #: (n,) array, whether it reached the largest error and is not used
    samples: int  #: number of pairs of true poses, or of observations

    def part(self, errors: slice) -> 'ErrorEstimate':
        """Return the estimate of some of the errors."""
        return ErrorEstimate(
            self.values[errors], self.sigma[errors], self.is_known[errors],
            self.is_at_limit[errors], self.samples)


def shown_errors(
    fitted: Callable[[Array, Flags], ErrorFit], limits: ErrorLimits, stamps: Stamps, given: Array
) -> tuple[ErrorEstimate, ErrorFit]:
    """
    Return the errors that the data show, and the fit of all errors.

    Of two errors that are the same in the data, the first counts.

    Parameters
    ----------
    fitted : returns the fit, given values (n,) of the errors and which of them are free; it has as
        many residuals of each pair, in the order of `stamps`
    limits : limits of the errors
    stamps : (k,) array, stamps of the pairs [ns]
    given : (n,) array, errors where the data do not determine them

    """
    block, n = blocks(stamps), len(given)
    free, fixed = np.ones(n, bool), limits.none.copy()
    is_known, is_at_limit = np.ones(n, bool), np.zeros(n, bool)
    of_all = fit = fitted(fixed, free)
    while True:
        x = fit.x[:n]
        of_independent, sigma = (errors[:n] for errors in fit.standard_errors(block))
        known, shown, at_limit = limits.judged(x, sigma)
        hidden = np.flatnonzero(free & ~shown)
        if not len(hidden):
            _, sigma = of_all.standard_errors(block)
            return ErrorEstimate(x, sigma[:n], is_known, is_at_limit, len(stamps)), of_all
        k = hidden[-1]
        free[k], is_known[k] = False, known[k]
        fixed[k] = limits.none[k] if known[k] else given[k]
        is_at_limit[k] = at_limit[k] and of_independent[k] < limits.max_standard_error[k]
        fit = fitted(fixed, free)
