# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors of one robot by the landmarks that it observes again within seconds.

The motion by corrected odometry leads from one observation of a landmark to the next. The scale of
distances is that of the sensor, by which the map is made. Bearings are measured from the direction
of travel by odometry: a bearing bias turns the motion that observations show. The position of the
sensor, which shows where the robot turns, is fitted beside these errors.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.calibration import observation_errors, odometry_errors
from fej_slam_ros.core.calibration.instruments import (
    measured_motion, PairMotion, predicted_motion)
from fej_slam_ros.core.calibration.observation_errors import given_observations
from fej_slam_ros.core.calibration.observation_pairs import (
    observation_pairs, ObservationPairs)
from fej_slam_ros.core.calibration.odometry_errors import given_odometry, scatter
from fej_slam_ros.core.calibration.shown_errors import (
    blocks, ErrorEstimate, ErrorFit, ErrorLimits, MIN_SIGMAS, shown_errors, suffice)
from fej_slam_ros.core.geometry import Array, Flags, Stamps
from fej_slam_ros.core.ordering.corrected_observations import without_systematic_errors
from fej_slam_ros.core.records import NS, Odometry, Scan
from fej_slam_ros.core.settings import RobotSettings

#: Maximum time between the two observations of a landmark [ns].
MAX_LANDMARK_TIME = 3 * NS
#: Limits of the errors of odometry and the bearing bias [rad].
LIMITS = ErrorLimits(*map(np.append, odometry_errors.LIMITS, (
    of_both[1] for of_both in observation_errors.LIMITS)))
#: Standard deviations of the position of the sensor [m]: ahead, where settings often leave it out,
#: and aside; and the largest error that is searched. On circles about one centre, the former is a
#: bearing bias and the latter a scale of distances.
POSITION_SIGMA, MAX_POSITION = (0.1, 0.02), 0.5
#: Smallest error of a coordinate of the position that is reported [m].
MIN_POSITION = 0.1
#: Maximum number of iterations by instruments, and the step of all values after which they end.
MAX_ITERATIONS, MAX_STEP = 30, 1e-7


class ErrorsByLandmarks(NamedTuple):
    """Systematic errors of a robot; those not determined are as its settings have them."""

    odometry: ErrorEstimate  #: scales of distances and turns, and turn bias
    observations: ErrorEstimate  #: range scale, always that of the settings, and bearing bias
    #: (2,) array, of the sensor, ahead and to the left of the given one [m]; 0 where not shown
    position: Array


def fit_to_landmarks(
    odometry: Sequence[Odometry], scans: Sequence[Scan], robot: RobotSettings
) -> ErrorsByLandmarks | None:
    """
    Return the errors of a robot by its odometry and observations of landmarks, both by stamps.

    None if too few landmarks are observed again.

    """
    range_scale, bearing_bias = given_observations(robot)
    ranges_only = replace(robot, observation_bearing_bias=0.0)
    pairs = observation_pairs(
        odometry, [without_systematic_errors(scan, ranges_only) for scan in scans],
        MAX_LANDMARK_TIME)
    stamps = pairs.stamps[0]
    if not suffice(stamps):
        return None
    fitted = partial(_by_instruments, measured_motion(pairs), predicted_motion(pairs))
    found, of_all = shown_errors(
        fitted, LIMITS, stamps, np.append(given_odometry(robot), bearing_bias))
    bearing = found.part(slice(3, 4))
    # On circles, and where odometry is far off, a bias is not told from the position.
    return ErrorsByLandmarks(
        found.part(slice(3)), _with_range_scale(range_scale, bearing),
        _shown_position(of_all, stamps) * bearing.is_known)


def _with_range_scale(given: float, bearing: ErrorEstimate) -> ErrorEstimate:
    """Return the errors of observations: the range scale as given, and the bearing bias."""
    return ErrorEstimate(
        np.append(given, bearing.values), np.append(np.inf, bearing.sigma),
        np.append(False, bearing.is_known), np.append(False, bearing.is_at_limit),
        bearing.samples)


def _shown_position(fit: ErrorFit, stamps: Stamps) -> Array:
    """Return the position (2,) of the sensor by a fit of all errors, 0 where none is shown."""
    x, (_, sigma) = fit.x[-2:], fit.standard_errors(blocks(stamps))
    return np.where(np.abs(x) > np.maximum(MIN_SIGMAS * sigma[-2:], MIN_POSITION), x, 0.0)


def _by_instruments(
    measured: PairMotion, predicted: PairMotion, fixed: Array, free: Flags
) -> ErrorFit:
    """
    Return the errors of which some are `free`, others `fixed`, by instrumental variables.

    The position of the sensor follows them. All solve sum Z' w r = 0 for the normalised
    differences r of pairs, their robust weights w, and the derivatives Z by predicted motion.

    """
    free, x = np.append(free, [True, True]), np.append(fixed, np.zeros(2))
    none, start = np.append(LIMITS.none, np.zeros(2)), x
    prior = np.diag(np.append(LIMITS.prior_sigma, POSITION_SIGMA) ** -2.0)
    limits = np.where(free, np.append(LIMITS.max_error, [MAX_POSITION] * 2), 0.0)
    for _ in range(MAX_ITERATIONS):
        r = _differences(measured.pairs, x)
        variance = scatter(r) ** 2
        # The weights of soft_l1.
        cost = 2.0 * variance + np.sum(r ** 2, axis=1)
        Zw = predicted.jacobian(x) * np.sqrt(2.0 / (cost * variance))[:, None, None] * free
        J = measured.jacobian(x) * free
        gradients = (Zw * r[:, :, None]).reshape(-1, len(x))
        gradient = gradients.sum(axis=0) + prior @ (x - none) * free
        before, step = x, np.linalg.solve(np.einsum('nji,njk->ik', Zw, J) + prior, gradient)
        x = np.clip(x - step, start - limits, start + limits)
        if np.all(np.abs(x - before) < MAX_STEP):
            break
    # The derivative of w r is w (I - r r' / cost) J.
    J = J - r[:, :, None] * (np.einsum('nj,njk->nk', r, J) / cost[:, None])[:, None]
    weights = np.abs(Zw * J).reshape(gradients.shape)
    return ErrorFit(x, np.einsum('nji,njk->ik', Zw, J) + prior, gradients, weights, 1.0)


def _differences(pairs: ObservationPairs, values: Array) -> Array:
    """Return the normalised differences (n, 2) of pairs without errors, `values` (6,)."""
    *of_odometry, bearing_bias, x, y = values
    moved = replace(pairs, odometry=pairs.odometry.without_errors(np.array(of_odometry)))
    placed = moved.at_odometry(0.0)
    # In the base frame, which headings summed up over the whole run do not turn.
    r: Array = np.einsum(
        'nji,nj->ni', placed.A, placed.residuals(np.array([x, y, -bearing_bias])))
    return r
