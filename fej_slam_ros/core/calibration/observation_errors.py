# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Systematic errors of the observations of one robot by ground truth: range scale and bearing bias.

With positions as complex numbers, a landmark or robot at l, observed at z from the true pose
(p, theta), gives

    e^(i theta) z = beta (l - p) + noise,   beta = e^(i bearing_bias) / range_scale.

Where l is not recorded, both sides are differences from their means over the observations of this
landmark. True poses are exact beside observations, so that least squares has no bias by noise.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from fej_slam_ros.core.calibration.offset_regression import Complex, regression
from fej_slam_ros.core.calibration.shown_errors import (
    blocks, ErrorEstimate, ErrorLimits, suffice)
from fej_slam_ros.core.calibration.team_records import NearTruth
from fej_slam_ros.core.geometry import Array, Flags, Indices
from fej_slam_ros.core.records import AnyScan, Observation
from fej_slam_ros.core.settings import RobotSettings

#: Limits of the range scale and the bearing bias [rad].
LIMITS = ErrorLimits(
    none=np.array([1.0, 0.0]), prior_sigma=np.array([0.1, 0.1]),
    max_standard_error=np.array([0.01, 0.01]), min_error=np.array([0.005, 0.005]))
#: Number of an observed place that is recorded.
RECORDED = -1


def given_observations(robot: RobotSettings) -> Array:
    """Return the errors (2,) of observations that the settings of a robot correct."""
    return np.array([robot.observation_range_scale, robot.observation_bearing_bias])


@dataclass(frozen=True, slots=True, eq=False)
class _Positions:
    """Positions of what is observed relative to the observer, in the axes of ``map``."""

    stamps: NDArray[np.int64]  #: (n,) array [ns]
    places: Indices  #: (n,) array, number of the landmark, or RECORDED
    true: Complex  #: (n,) array, l - p, or -p where l is not recorded
    observed: Complex  #: (n,) array, e^(i theta) z
    weights: Array  #: (n,) array, inverse of the variance of a coordinate

    def equations(self, kept: Flags) -> tuple[Complex, Complex]:
        """Return the factors (n, 1) of beta, and the products (n,), see `regression`."""
        return (
            self._differences(self.true, kept)[:, None], self._differences(self.observed, kept))

    def _differences(self, positions: Complex, kept: Flags) -> Complex:
        """Return positions (n,) less, where l is not recorded, the weighted mean of those kept."""
        is_open = self.places != RECORDED
        places, weights = self.places[is_open], (self.weights * kept)[is_open]
        total = np.maximum(np.bincount(places, weights), np.finfo(float).tiny)
        x, y = (
            np.bincount(places, weights * part[is_open]) / total
            for part in (positions.real, positions.imag))
        differences = positions.copy()
        differences[is_open] -= (x + 1j * y)[places]
        return differences


def fit_observations(
    scans: Sequence[AnyScan], landmarks: Mapping[int, Array], near: Mapping[str, NearTruth],
    heading_sigma: float, given: Array,
) -> ErrorEstimate | None:
    """
    Return the errors of the observations of a robot, None if too few have ground truth.

    Parameters
    ----------
    scans : those of the robot, of landmarks and of robots
    landmarks : recorded true positions (2,), by ID
    near : true poses by robot
    heading_sigma : standard error of the true headings [rad], infinite if unknown
    given : (2,) array, errors where the data do not determine them

    """
    positions = _positions(scans, landmarks, near)
    if not suffice(positions.stamps):
        return None
    fit = regression(positions.equations, positions.weights)
    if fit is None:
        return None
    # Errors within a block may depend on each other.
    block = blocks(positions.stamps)
    sigma = [
        max(fit.sigma, float(np.linalg.norm(np.bincount(block, part))))
        for part in (fit.relative.real, fit.relative.imag)]
    scale = 1.0 / abs(fit.c)
    return _significant(
        np.array([scale, np.angle(fit.c)]),
        np.array([scale * sigma[0], math.hypot(sigma[1], heading_sigma)]), given,
        int(np.count_nonzero(fit.relative)))


def _positions(
    scans: Sequence[AnyScan], landmarks: Mapping[int, Array], near: Mapping[str, NearTruth]
) -> _Positions:
    """Return the observations from known true poses."""
    rows = [row for scan in scans for row in _rows(scan, landmarks, near)]
    stamps, ids, true, observed, weights = zip(*rows) if rows else ((),) * 5
    number = {id_: k for k, id_ in enumerate(dict.fromkeys(ids))} | {None: RECORDED}
    return _Positions(
        np.array(stamps, np.int64), np.array([number[id_] for id_ in ids], np.intp),
        np.array(true, complex), np.array(observed, complex), np.array(weights))


def _rows(
    scan: AnyScan, landmarks: Mapping[int, Array], near: Mapping[str, NearTruth]
) -> Iterator[tuple[int, int | None, complex, complex, float]]:
    """Yield stamp, ID if its position is not recorded, and the other columns of `_Positions`."""
    pose = near[scan.robot].pose(scan.stamp)
    if pose is None:
        return
    p, heading = complex(*pose[:2]), np.exp(1j * pose[2])
    for o in scan.observations:
        if isinstance(o, Observation):
            place, open_id = landmarks.get(o.id), None if o.id in landmarks else o.id
        else:
            place, open_id = near[o.observed].pose(scan.stamp), None
            if place is None:
                continue
        yield (
            scan.stamp, open_id, (0.0 if place is None else complex(*place[:2])) - p,
            heading * complex(*o.z), 2.0 / float(np.trace(o.R)))


def _significant(
    found: Array, sigma: Array, given: Array, observations: int
) -> ErrorEstimate:
    """Return the errors that the data show; those not determined are as given."""
    known, shown, at_limit = LIMITS.judged(found, sigma)
    return ErrorEstimate(
        np.where(shown, found, np.where(known, LIMITS.none, given)), sigma, known,
        at_limit & (sigma < LIMITS.max_standard_error), observations)
