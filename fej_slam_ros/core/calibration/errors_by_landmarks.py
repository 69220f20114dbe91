# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors of one robot by the landmarks that it observes again within seconds.

The motion by corrected odometry leads from one observation of a landmark to the next. The scale of
distances is that of the sensor, by which the map is made. Bearings are measured from the direction
of travel by odometry: a bearing bias turns the motion that observations show. The position of the
sensor, which shows where the robot turns, and the delay of its stamps, which shows where speeds
change, are fitted beside these errors.
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
    MAX_STAMP_ERROR, observation_pairs, ObservationPairs)
from fej_slam_ros.core.calibration.odometry_errors import given_odometry, scatter
from fej_slam_ros.core.calibration.shown_errors import (
    blocks, ErrorEstimate, ErrorFit, ErrorLimits, MIN_SIGMAS, shown_errors, suffice)
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.ordering.corrected_observations import without_observation_errors
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
#: Standard deviation of the delay of stamps [s], and the largest one that is searched.
DELAY_SIGMA, MAX_DELAY = 0.2, MAX_STAMP_ERROR
#: Smallest error of a coordinate of the position [m], and smallest delay [s], that is reported.
MIN_POSITION, MIN_DELAY = 0.1, 0.05
#: The smallest errors of all values that are reported.
SMALLEST = np.append(LIMITS.min_error, [MIN_POSITION, MIN_POSITION, MIN_DELAY])
#: Error of the turn scale from which on delays are not told from it.
MAX_TURN_ERROR = 0.15
#: Places of the position and the delay among the values that are fitted.
POSITION, DELAY = slice(4, 6), 6
#: Maximum number of iterations by instruments, and the step of all values after which they end.
MAX_ITERATIONS, MAX_STEP = 30, 1e-7


class ErrorsByLandmarks(NamedTuple):
    """Systematic errors of a robot; those not determined are as its settings have them."""

    odometry: ErrorEstimate  #: scales of distances and turns, and turn bias
    observations: ErrorEstimate  #: range scale, always that of the settings, and bearing bias
    #: (2,) array, of the sensor, ahead and to the left of the given one [m]; 0 where not shown
    position: Array
    #: by which the stamps of its observations are too late [s]; 0 where none is shown
    delay: float


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
        odometry, [without_observation_errors(scan, ranges_only) for scan in scans],
        MAX_LANDMARK_TIME)
    stamps = pairs.stamps[0]
    if not suffice(stamps):
        return None
    measured = measured_motion(pairs)
    fitted = partial(_by_instruments, measured, predicted_motion(measured))
    found, of_all = shown_errors(
        fitted, LIMITS, stamps, np.append(given_odometry(robot), bearing_bias))
    bearing = found.part(slice(3, 4))
    _, sigma = of_all.standard_errors(blocks(stamps))
    # On circles, and where odometry is far off, a bias is not told from the position.
    return ErrorsByLandmarks(
        found.part(slice(3)), _with_range_scale(range_scale, bearing),
        _shown_position(of_all.x, sigma) * bearing.is_known,
        _shown_delay(of_all.x, sigma) if abs(found.values[1] - 1.0) < MAX_TURN_ERROR else 0.0)


def _with_range_scale(given: float, bearing: ErrorEstimate) -> ErrorEstimate:
    """Return the errors of observations: the range scale as given, and the bearing bias."""
    return ErrorEstimate(
        np.append(given, bearing.values), np.append(np.inf, bearing.sigma),
        np.append(False, bearing.is_known), np.append(False, bearing.is_at_limit),
        bearing.samples)


def _shown_position(x: Array, sigma: Array) -> Array:
    """Return the position (2,) of the sensor by values and standard errors, 0 where not shown."""
    is_shown = np.abs(x[POSITION]) > np.maximum(MIN_SIGMAS * sigma[POSITION], MIN_POSITION)
    return np.where(is_shown, x[POSITION], 0.0)


def _shown_delay(x: Array, sigma: Array) -> float:
    """Return the delay of stamps [s] by values and standard errors, 0 where none is shown."""
    delay, shown = float(x[DELAY]), max(MIN_SIGMAS * float(sigma[DELAY]), MIN_DELAY)
    return delay if shown < abs(delay) < 0.99 * MAX_DELAY else 0.0


def _by_instruments(
    measured: PairMotion, predicted: PairMotion, fixed: Array, free: Flags
) -> ErrorFit:
    """
    Return the errors of which some are `free`, others `fixed`, by instrumental variables.

    The position of the sensor and the delay of its stamps follow them. All solve sum Z' w r = 0
    for the normalised differences r of pairs, their robust weights w, and the derivatives Z by
    predicted motion.

    """
    free, x = np.append(free, [True] * 3), np.append(fixed, np.zeros(3))
    none, start = np.append(LIMITS.none, np.zeros(3)), x
    prior = np.diag(np.append(LIMITS.prior_sigma, [*POSITION_SIGMA, DELAY_SIGMA]) ** -2.0)
    limits = np.where(
        free, np.append(LIMITS.max_error, [MAX_POSITION, MAX_POSITION, MAX_DELAY]), 0.0)
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
    # A fit that goes to and fro shows nothing.
    is_found = np.all(np.abs(x - before) < SMALLEST)
    return ErrorFit(
        x, np.einsum('nji,njk->ik', Zw, J) + prior, gradients, weights,
        1.0 if is_found else np.inf)


def _differences(pairs: ObservationPairs, values: Array) -> Array:
    """Return the normalised differences (n, 2) of pairs without errors, `values` (7,)."""
    *of_odometry, bearing_bias, x, y, delay = values
    moved = replace(pairs, odometry=pairs.odometry.without_errors(np.array(of_odometry)))
    placed = moved.at_odometry(delay)
    # In the base frame, which headings summed up over the whole run do not turn.
    r: Array = np.einsum(
        'nji,nj->ni', placed.A, placed.residuals(np.array([x, y, -bearing_bias])))
    return r
