# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise scale factors from normalised errors without outliers."""

from collections.abc import Mapping, Sequence
import math

import numpy as np

from fej_slam_ros.core.calibration.robot_scales import different_robots, NoiseScale
from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.geometry import Array, Flags

#: Variance of normalised errors below which these are rounding, of data without noise.
MIN_VARIANCE = 1e-12
#: Tail probability beyond which an error is an outlier. The limit of a gate would cut the heavy
#: tails of real noise, and so give factors that are too small.
OUTLIER_PROBABILITY = 1e-6
#: Largest standard error of a usable factor of a robot like the others, relative.
MAX_OWN_ERROR = 0.05

#: Normalised errors squared, e^T P^-1 e, of one kind by robot.
Errors = Mapping[str, Sequence[float]]


def noise_scale(squared: Sequence[float], dof: int) -> NoiseScale:
    """
    Return the root mean error squared e^T P^-1 e per degree of freedom, without outliers.

    Iterated from the median, until there are no further inliers. If most errors are 0 or rounding,
    as of a simulated robot without noise, they determine no factor.

    """
    d2 = np.array(squared)
    limit = _outlier_limit(dof)
    variance, kept = float(np.median(d2)) / chi_square_limit(dof, 0.5), 0
    while (count := int((d2 <= limit * variance).sum())) > kept:
        variance, kept = float(d2[d2 <= limit * variance].mean()) / dof, count
    if variance < MIN_VARIANCE:
        return NoiseScale(1.0, math.inf, len(d2))
    return NoiseScale(math.sqrt(variance), 1.0 / math.sqrt(2 * dof * len(d2)), len(d2))


def _outlier_limit(dof: int) -> float:
    """Return the normalised error squared of noise of scale 1 beyond which it is an outlier."""
    return chi_square_limit(dof, OUTLIER_PROBABILITY)


def inliers(squared: Array) -> Flags:
    """Return which normalised errors of points, squared, (n,), are no outliers."""
    return squared <= _outlier_limit(2) * noise_scale(squared.tolist(), 2).scale ** 2


def noise_scales(errors: Errors, dof: int) -> dict[str, NoiseScale]:
    """
    Return the factor of the team under '', and those of robots that have their own.

    These have enough data, or differ from all others, whose factor is then that of the team.

    """
    own = {robot: noise_scale(squared, dof) for robot, squared in errors.items() if squared}
    different = different_robots(own, lambda excluded: _without(errors, excluded, dof))
    return {'': _without(errors, {*different}, dof)} | {
        robot: found for robot, found in own.items()
        if robot in different or found.relative_error <= MAX_OWN_ERROR}


def _without(errors: Errors, excluded: set[str], dof: int) -> NoiseScale:
    """Return the factor of all robots but the excluded ones."""
    return noise_scale(
        [d2 for robot, squared in errors.items() if robot not in excluded for d2 in squared], dof)
