# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Whether a sensor is where and as its observations say: its pose on the robot, handedness and time.

Landmarks stand still. Two observations of one landmark therefore agree after the motion between
them by odometry, over a second or two, unless the sensor is elsewhere, its frame is left-handed or
does not move with the robot, its bearings are wrong, or its stamps are early or late. Each of
these is fitted by itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from fej_slam_ros.core.calibration.observation_pairs import (
    MAX_STAMP_ERROR, observation_pairs, PlacedPairs)
from fej_slam_ros.core.calibration.shown_errors import blocks, MIN_BLOCKS, MIN_FIT_PAIRS
from fej_slam_ros.core.geometry import Array, products, Stamps, wrap
from fej_slam_ros.core.records import NS, Odometry, Scan

#: Time between the two observations of a pair [ns]: odometry is still exact.
PAIR_TIME = 3 * NS // 2
#: Error of a sensor pose [m, m, rad] that is large, and the weight for each pair of the prior that
#: keeps the pose near the given one where the motion does not determine it: on circles about one
#: centre, turns about it change nothing.
POSE_SCALE, WEIGHT = np.array([0.5, 0.5, 0.5]), 0.2
#: Minimum mean square change of the normalised differences by such an error; with less, the motion
#: does not determine the pose.
MIN_WEIGHT = 0.1
#: Minimum share of ranges that must fit the motion where only bearings are wrong, maximum share
#: where they are those of other pairs, and maximum mean resultant length of the changes of such
#: bearings. In MRCLAM set 6, where robots often rest, it is 1.00, and at most 0.57 in degrees.
RANGES_FIT, RANGES_DIFFER, BEARINGS_DIFFER = 0.95, 0.7, 0.6


@dataclass(frozen=True, slots=True, eq=False)
class SensorFit:
    """
    How well pairs of observations agree under each assumption, 1 for the noise that they claim.

    The values are root median squared distances divided by that of a chi-square distribution of
    two degrees of freedom.

    """

    pairs: int  #: number of pairs of observations
    as_given: float  #: agreement with the pose and the stamps of the sensor as they are
    moved: float  #: agreement with another pose
    #: (3,) array, this pose of the frame of the observations in the base frame [m, m, rad]
    pose: Array
    is_determined: bool  #: whether the motion determines it: not on circles about one centre
    delayed: float  #: agreement with other stamps
    delay: float  #: by which these are later than those given [s]
    delay_sigmas: float  #: gain by this delay, in standard errors of the gain
    mirrored: float  #: agreement with left and right exchanged, at the best pose
    still: float  #: agreement without any motion: in map, or of what moves with the robot
    bearings_differ: bool  #: whether the ranges of pairs agree, but not at all their bearings


def fit_sensor(odometry: Sequence[Odometry], scans: Sequence[Scan]) -> SensorFit | None:
    """
    Return how observations of landmarks agree with the odometry of their robot, both by stamps.

    None if there are too few pairs of observations while odometry was there.

    """
    pairs = observation_pairs(odometry, scans, PAIR_TIME)
    if len(pairs.sigma) < MIN_FIT_PAIRS:
        return None
    given = pairs.at_odometry(0.0)
    pose, none = _fitted(given), np.zeros(3)
    delay = float(minimize_scalar(
        lambda delay: _agreement(pairs.at_odometry(delay), none),
        bounds=(-MAX_STAMP_ERROR, MAX_STAMP_ERROR), method='bounded').x)
    delayed, as_given = pairs.at_odometry(delay), _agreement(given, none)
    mirrored = replace(pairs, z=pairs.z * [1.0, -1.0]).at_odometry(0.0)
    return SensorFit(
        len(pairs.sigma), as_given, _agreement(given, pose), pose,
        _is_determined(given, pose), _agreement(delayed, none), delay,
        _sigmas(_costs(given, as_given) - _costs(delayed, as_given), pairs.stamps[0]),
        _agreement(mirrored, _fitted(mirrored)), _agreement(pairs.still(), none),
        _bearings_differ(given))


def _sigmas(gains: Array, stamps: Stamps) -> float:
    """Return gains (n,), which depend within blocks of time, in standard errors; 0 if few."""
    of_blocks = np.bincount(blocks(stamps), gains)
    if len(of_blocks) < MIN_BLOCKS:
        return 0.0
    # A gain is that of an error squared, so that a few sharp turns would count for all.
    roots = np.sign(of_blocks) * np.sqrt(np.abs(of_blocks))
    spread = np.sqrt(np.sum((roots - roots.mean()) ** 2))
    return float(roots.sum() / spread) if spread > 0.0 else 0.0  # no spread: it stands still


def _agreement(pairs: PlacedPairs, pose: Array) -> float:
    """Return the root median squared distance, 1 for the claimed noise."""
    squared = np.sum(pairs.residuals(pose) ** 2, axis=1)
    return float(np.sqrt(np.median(squared) / (2.0 * np.log(2.0))))


def _costs(pairs: PlacedPairs, scale: float) -> Array:
    """Return the robust loss (n,) of the differences as given, for a scale of their noise."""
    squared = np.sum(pairs.residuals(np.zeros(3)) ** 2, axis=1)
    # No scale: observations are repeated, so that all differences are zero.
    costs: Array = np.sqrt(1.0 + squared / (scale ** 2 or 1.0))
    return costs


def _is_determined(pairs: PlacedPairs, pose: Array) -> bool:
    """Return whether a change of each part of a pose (3,) changes the differences."""
    J = pairs.jacobian(pose).reshape(-1, 3) * POSE_SCALE
    return float(np.linalg.eigvalsh(J.T @ J)[0]) > MIN_WEIGHT * len(J)


def _bearings_differ(pairs: PlacedPairs) -> bool:
    """Return whether the ranges of pairs fit the motion, but not at all their bearings."""
    first, second = np.hypot(*pairs.p.T), np.hypot(*pairs.q.T)
    limit = np.hypot(*pairs.motion.T) + 3.0 * pairs.sigma
    fit, others_fit = (
        np.mean(np.abs(first - ranges) <= limit)
        for ranges in (second, np.roll(second, len(second) // 2)))
    expected = products(pairs.A, pairs.p) + pairs.motion
    turned = products(pairs.B, pairs.q)
    change = np.arctan2(*turned.T) - np.arctan2(*expected.T)
    return bool(
        fit >= RANGES_FIT and others_fit <= RANGES_DIFFER
        and abs(np.mean(np.exp(1j * change))) <= BEARINGS_DIFFER)


def _fitted(pairs: PlacedPairs) -> Array:
    """Return the pose (3,) of the frame of observations under which pairs agree best."""
    # One small residual for each pair stays in the quadratic part of the robust loss.
    prior = np.tile(WEIGHT * np.diag(1.0 / POSE_SCALE), (len(pairs.sigma), 1))

    def residuals(pose: Array) -> Array:
        return np.append(pairs.residuals(pose).ravel(), prior @ pose)

    def jacobian(pose: Array) -> Array:
        return np.vstack([pairs.jacobian(pose).reshape(-1, 3), prior])

    best = min(
        (least_squares(residuals, np.array([0.0, 0.0, yaw]), jacobian, loss='soft_l1')
         for yaw in np.arange(4) * np.pi / 2.0), key=lambda fit: float(fit.cost))
    x, y, yaw = best.x
    return np.array([x, y, wrap(yaw)])
