# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors of the odometry of one robot by its true poses.

They are the scale of distances, that of turns, and the turn bias, the turn rate at rest [rad/s].

Over some seconds, the motion by corrected odometry leads from one true pose to another. The errors
that do so best are found by robust least squares.
"""

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from fej_slam_ros.core.calibration.shown_errors import (
    ErrorEstimate, ErrorFit, ErrorLimits, shown_errors)
from fej_slam_ros.core.calibration.true_motions import TrueMotions
from fej_slam_ros.core.geometry import Array, Flags, pose_difference
from fej_slam_ros.core.settings import RobotSettings

#: Limits of the scale of distances, that of turns, which is 0.5 to 0.7 where four wheels skid, and
#: the turn bias [rad/s].
LIMITS = ErrorLimits(
    none=np.array([1.0, 1.0, 0.0]), prior_sigma=np.array([0.1, 0.2, 0.05]),
    max_standard_error=np.array([0.02, 0.02, 0.002]), min_error=np.array([0.005, 0.005, 0.0005]))
#: Standard deviation of a normal distribution, divided by the median of its magnitudes.
SIGMA_PER_MEDIAN = 1.4826

#: Returns the residuals (n,) for values (3,) of the errors.
Residuals = Callable[[Array], Array]


def given_odometry(robot: RobotSettings) -> Array:
    """Return the errors (3,) of odometry that the settings of a robot correct."""
    return np.array([*robot.odometry_scale, robot.odometry_turn_bias])


def fit_to_truth(motions: TrueMotions, given: Array) -> ErrorEstimate:
    """Return the errors of odometry; those that the data do not determine are as `given` (3,)."""
    def errors(values: Array) -> Array:
        e = pose_difference(motions.true, motions.by_odometry(values))
        # Relative to the scale: otherwise the scale 0, at which odometry has no noise, fits best.
        return e / values[[0, 0, 1]]

    # Metres and radians are made comparable by the residuals of a first fit.
    first = _least(lambda values: errors(values).ravel(), LIMITS.none, np.ones(3, bool))
    spread = SIGMA_PER_MEDIAN * np.median(np.abs(errors(first.x)), axis=0)
    shown, _ = shown_errors(
        partial(_least, lambda values: (errors(values) / np.maximum(spread, 1e-6)).ravel()),
        LIMITS, motions.firsts, given)
    return shown


def _least(residuals: Residuals, fixed: Array, free: Flags) -> ErrorFit:
    """Return the errors with the least squares, of which some are `free`, others `fixed`."""
    none, prior_sigma = LIMITS.none[free], LIMITS.prior_sigma[free]

    def of_free(values: Array) -> Array:
        errors = fixed.copy()
        errors[free] = values
        return np.append(residuals(errors), (values - none) / prior_sigma)

    x, gradients = fixed.copy(), np.zeros((len(residuals(fixed)), 3))
    weights = np.zeros_like(gradients)
    information = np.diag(1.0 / np.square(LIMITS.prior_sigma))
    if free.any():
        limit = LIMITS.max_error[free]
        fit = least_squares(
            of_free, none, loss='soft_l1', x_scale=limit, bounds=(none - limit, none + limit))
        x[free] = fit.x
        information[np.ix_(free, free)] = fit.jac.T @ fit.jac
        # SciPy scales J by (1 + r^2)^(-3/4), and the gradient of soft_l1 has (1 + r^2)^(-1/2).
        r, J = (rows[:len(gradients)] for rows in (fit.fun, fit.jac))
        gradients[:, free], weights[:, free] = (r * (1.0 + r ** 2) ** 0.25)[:, None] * J, J ** 2
    return ErrorFit(x, information, gradients, weights, scatter(residuals(x)))


def scatter(residuals: Array) -> float:
    """Return the standard deviation of residuals by their median."""
    return max(SIGMA_PER_MEDIAN * float(np.median(np.abs(residuals))), 1e-12)
