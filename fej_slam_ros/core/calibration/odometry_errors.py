# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors of the odometry of one robot: scales of distances and turns, turn rate at rest.

Over some seconds, the motion by corrected odometry leads from one true pose to another, and from
one observation of a landmark to the next. The errors that do so best are found by robust least
squares from true poses, and by instrumental variables from landmarks, where the scale of
distances is that of the sensor, by which the map is made.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from fej_slam_ros.core.calibration.corrected_odometry import corrected_trajectory
from fej_slam_ros.core.calibration.instruments import (
    measured_motion, PairMotion, predicted_motion)
from fej_slam_ros.core.calibration.sensor_pose import (
    observation_pairs, ObservationPairs)
from fej_slam_ros.core.calibration.true_motions import TrueMotions
from fej_slam_ros.core.consistency import pose_error
from fej_slam_ros.core.geometry import Array, Flags, Indices, Stamps
from fej_slam_ros.core.records import NS, Odometry, Scan

#: Maximum time between the two observations of a landmark [ns].
MAX_LANDMARK_TIME = 3 * NS
#: Minimum number of pairs of observations.
MIN_FIT_PAIRS = 60
#: Odometry without systematic errors: scale of distances, scale of turns, turn bias [rad/s].
NO_ERRORS = np.array([1.0, 1.0, 0.0])
#: Prior standard deviations of these; they keep a value at NO_ERRORS that the data leave open.
PRIOR_SIGMA = np.array([0.1, 0.1, 0.05])
#: A value is determined if its standard error is below this.
MAX_STANDARD_ERROR = np.array([0.02, 0.02, 0.002])
#: A determined value is an error if it differs from NO_ERRORS by more than this, and by more than
#: MIN_SIGMAS standard errors.
MIN_ERROR, MIN_SIGMAS = np.array([0.005, 0.005, 0.0005]), 4.0
#: Largest difference from NO_ERRORS that is searched.
MAX_ERROR = 3.0 * PRIOR_SIGMA
#: Length [ns] of the blocks within which residuals count as dependent, since pairs share odometry,
#: and minimum number of blocks.
BLOCK_TIME, MIN_BLOCKS = 10 * NS, 10
#: Standard deviation of a normal distribution, divided by the median of its magnitudes.
SIGMA_PER_MEDIAN = 1.4826
#: Maximum number of iterations by instruments, and the step of all values after which they end.
MAX_ITERATIONS, MAX_STEP = 30, 1e-7

#: Returns the residuals (n,) for values (3,) of the errors.
Residuals = Callable[[Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class OdometryErrors:
    """Systematic errors of odometry: the scales of distances and turns, and the turn bias."""

    values: Array  #: (3,) array; the given values where the data do not determine them
    sigma: Array  #: (3,) array, standard errors of a fit of all three
    is_known: Flags  #: (3,) array, whether the data determine the value, perhaps as NO_ERRORS
    is_at_limit: bool  #: whether a value reached MAX_ERROR and is therefore not used
    pairs: int  #: number of pairs of true poses or of observations


def fit_to_truth(motions: TrueMotions, given: Array) -> OdometryErrors:
    """Return the errors of odometry; those that the data do not determine are as `given` (3,)."""
    def errors(values: Array) -> Array:
        e = pose_error(motions.true, motions.by_odometry(values))
        # Relative to the scale: otherwise the scale 0, at which odometry has no noise, fits best.
        scaled: Array = e / values[[0, 0, 1]]
        return scaled

    # Metres and radians are made comparable by the residuals of a first fit.
    first = _least(lambda values: errors(values).ravel(), NO_ERRORS, np.ones(3, bool))
    spread = SIGMA_PER_MEDIAN * np.median(np.abs(errors(first.x)), axis=0)
    return _significant(
        partial(_least, lambda values: (errors(values) / np.maximum(spread, 1e-6)).ravel()),
        motions.firsts, given)


def fit_to_landmarks(
    odometry: Sequence[Odometry], scans: Sequence[Scan], given: Array
) -> OdometryErrors | None:
    """
    Return the errors of the odometry of a robot by its observations of landmarks, both by stamps.

    None if too few landmarks are observed again. Errors that the data do not determine are as
    `given`, a (3,) array.

    """
    pairs = observation_pairs(odometry, scans, MAX_LANDMARK_TIME)
    blocks = np.unique(pairs.stamps[0] // BLOCK_TIME)
    if len(pairs.sigma) < MIN_FIT_PAIRS or len(blocks) < MIN_BLOCKS:
        return None
    return _significant(
        partial(_by_instruments, measured_motion(pairs), predicted_motion(pairs)),
        pairs.stamps[0], given)


def _significant(
    fitted: Callable[[Array, Flags], '_Fit'], stamps: Stamps, given: Array
) -> OdometryErrors:
    """
    Return the errors that the data show; those not determined are as `given`, a (3,) array.

    `fitted` returns a fit by the errors, of which some are free, and by which these are. It has as
    many residuals of each pair, in the order of the `stamps` [ns] of the pairs.

    """
    _, block = np.unique(stamps // BLOCK_TIME, return_inverse=True)
    free, fixed, of_all = np.ones(3, bool), NO_ERRORS.copy(), np.empty(0)
    is_known, is_at_limit = np.ones(3, bool), False
    while True:
        fit = fitted(fixed, free)
        P = np.linalg.inv(fit.information)
        of_independent = np.sqrt(np.abs(np.diag(P))) * fit.scatter
        sigma = np.maximum(of_independent, np.sqrt(np.diag(P @ fit.covariance(block) @ P.T)))
        of_all = sigma if free.all() else of_all
        error = np.abs(fit.x - NO_ERRORS)
        at_limit = error > 0.99 * MAX_ERROR
        known = (sigma < MAX_STANDARD_ERROR) & ~at_limit
        shown = known & (error > np.maximum(MIN_SIGMAS * sigma, MIN_ERROR))
        hidden = np.flatnonzero(free & ~shown)
        if not len(hidden):
            return OdometryErrors(fit.x, of_all, is_known, is_at_limit, len(stamps))
        # At a constant turn rate, scale and bias are the same: it counts as a scale.
        k = hidden[-1]
        free[k], is_known[k] = False, known[k]
        fixed[k] = NO_ERRORS[k] if known[k] else given[k]
        is_at_limit |= bool(at_limit[k] and of_independent[k] < MAX_STANDARD_ERROR[k])


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Errors x (3,) of a fit, and the information (3, 3) about all of them."""

    x: Array
    information: Array  #: perhaps not symmetric
    gradients: Array  #: (k, 3) array, of half the robust cost of each residual
    scatter: float  #: standard deviation of the residuals

    def covariance(self, block: Indices) -> Array:
        """Return the (3, 3) covariance of the gradient for pairs that depend within blocks."""
        of_pairs = self.gradients.reshape(len(block), -1, 3).sum(axis=1)
        of_blocks = np.zeros((block.max() + 1, 3))
        np.add.at(of_blocks, block, of_pairs)
        # The mean is 0 but where an error is at its limit.
        of_blocks -= of_blocks.mean(axis=0)
        count = len(of_blocks)
        covariance: Array = of_blocks.T @ of_blocks * count / max(count - 3, 1)
        return covariance


def _least(residuals: Residuals, fixed: Array, free: Flags) -> _Fit:
    """Return the errors with the least squares, of which some are `free`, others `fixed`."""
    def of_free(values: Array) -> Array:
        errors = fixed.copy()
        errors[free] = values
        return np.append(residuals(errors), (values - NO_ERRORS[free]) / PRIOR_SIGMA[free])

    x, gradients = fixed.copy(), np.zeros((len(residuals(fixed)), 3))
    information = np.diag(1.0 / np.square(PRIOR_SIGMA))
    if free.any():
        start, limit = NO_ERRORS[free], MAX_ERROR[free]
        fit = least_squares(
            of_free, start, loss='soft_l1', x_scale=limit, bounds=(start - limit, start + limit))
        x[free] = fit.x
        information[np.ix_(free, free)] = fit.jac.T @ fit.jac
        # SciPy scales J by (1 + r^2)^(-3/4), and the gradient of soft_l1 has (1 + r^2)^(-1/2).
        r, J = (rows[:len(gradients)] for rows in (fit.fun, fit.jac))
        gradients[:, free] = (r * (1.0 + r ** 2) ** 0.25)[:, None] * J
    return _Fit(x, information, gradients, _scatter(residuals(x)))


def _by_instruments(
    measured: PairMotion, predicted: PairMotion, fixed: Array, free: Flags
) -> _Fit:
    """
    Return the errors of which some are `free`, others `fixed`, by instrumental variables.

    They solve sum Z' w r = 0 for the normalised differences r of pairs, their robust weights w,
    and the derivatives Z by predicted motion.

    """
    x, prior = fixed.copy(), np.diag(1.0 / np.square(PRIOR_SIGMA))
    limits = np.where(free, MAX_ERROR, 0.0)
    for _ in range(MAX_ITERATIONS):
        r = _differences(measured.pairs, x)
        variance = _scatter(r) ** 2
        # The weights of soft_l1.
        cost = 2.0 * variance + np.sum(r ** 2, axis=1)
        Zw = predicted.jacobian(x) * np.sqrt(2.0 / (cost * variance))[:, None, None] * free
        J = measured.jacobian(x) * free
        gradients = (Zw * r[:, :, None]).reshape(-1, 3)
        gradient = gradients.sum(axis=0) + prior @ (x - NO_ERRORS) * free
        before, step = x, np.linalg.solve(np.einsum('nji,njk->ik', Zw, J) + prior, gradient)
        x = np.clip(x - step, fixed - limits, fixed + limits)
        if np.all(np.abs(x - before) < MAX_STEP):
            break
    # The derivative of w r is w (I - r r' / cost) J.
    J = J - r[:, :, None] * (np.einsum('nj,njk->nk', r, J) / cost[:, None])[:, None]
    return _Fit(x, np.einsum('nji,njk->ik', Zw, J) + prior, gradients, 1.0)


def _differences(pairs: ObservationPairs, values: Array) -> Array:
    """Return the normalised differences (n, 2) of pairs by odometry corrected by `values` (3,)."""
    moved = replace(pairs, poses=corrected_trajectory(pairs.known, pairs.poses, values))
    placed = moved.at_odometry(0.0)
    # In the base frame, which headings summed up over the whole run do not turn.
    r: Array = np.einsum('nji,nj->ni', placed.A, placed.residuals(np.zeros(3)))
    return r


def _scatter(residuals: Array) -> float:
    """Return the standard deviation of residuals by their median."""
    return max(SIGMA_PER_MEDIAN * float(np.median(np.abs(residuals))), 1e-12)
