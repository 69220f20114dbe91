# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Options of the conversion of an MRCLAM set: delays, systematic errors and noise."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math

#: Standard deviation of the angles [rad] at which cameras are mounted.
OFFSET_SIGMA = 0.02


@dataclass(frozen=True)
class CameraNoise:
    """Standard deviations of observations."""

    range: float  #: Of a range, per metre
    bearing: float  #: Of a bearing [rad]
    range_constant: float = 0.0  #: Of a range, the part that does not grow with it [m]

    def at(self, r: float) -> tuple[float, float]:
        """Return the standard deviations [m, rad] of a range r [m] and its bearing."""
        return math.hypot(self.range_constant, self.range * r), self.bearing

    def scaled(self, factor: float) -> 'CameraNoise':
        return CameraNoise(
            factor * self.range, factor * self.bearing, factor * self.range_constant)


@dataclass(frozen=True)
class Noise:
    """
    Noise of commands and camera; the defaults are those of set 6 with its usual errors.

    Errors of commands persist for seconds, so they accumulate faster than those of independent
    samples: the variances are such that the accumulated variance is right after 5 s. Those of the
    defaults cover what is not known without ground truth.
    """

    #: Variances [m^2, rad^2] per metre driven and per radian turned.
    position: tuple[float, float] = (0.0022, 0.0010)
    heading: tuple[float, float] = (0.0060, 0.0068)
    #: Of observations of landmarks, and of robots.
    landmarks: CameraNoise = CameraNoise(0.044, 0.0125)
    robots: CameraNoise = CameraNoise(0.042, 0.0111)


@dataclass(frozen=True)
class ConversionOptions:
    """Parameters of the conversion."""

    motion_delay: float = 0.18  #: Delay from a command to the motion [s]
    camera_delay: float = 0.04  #: Delay from an image to the stamp of its observations [s]
    #: Ratios of true to commanded forward speed, driving straight ahead, and turn rate.
    odometry_scale: tuple[float, float] = (1.045, 0.947)
    #: Decrease of the first ratio per commanded turn rate [s/rad].
    slowdown: float = 1.17
    #: Turns that a robot was not commanded, by subject: [rad] per metre driven, and per radian
    #: turned; 0 for others.
    own_turns: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    #: Angles by which the bearings of a robot's camera are too large, by subject, with their
    #: standard deviations [rad]; 0 and `OFFSET_SIGMA` for others.
    bearing_offsets: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    #: Systematic errors of the ranges of a robot's camera, by subject: offset [m], and error per
    #: metre; 0 for others.
    range_errors: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    #: Parts by which ranges to landmarks and to robots are increased, see `range_increase`.
    range_increases: tuple[float, float] = (0.0, 0.0)
    thin: float = 1.0  #: Minimum time [s] between two observations of one subject by one robot
    #: Factor on the standard deviations of observations, for errors that persist among these
    correlation_factor: float = 1.5
    robot_observations: bool = True  #: If False, observations of robots are dropped
    noise: Noise = Noise()  #: Noise of commands and of single observations

    def observation_noise(self) -> Noise:
        """Return the noise with that of the observations as the estimator is to take it."""
        factor, noise = self.correlation_factor, self.noise
        return replace(
            noise, landmarks=noise.landmarks.scaled(factor), robots=noise.robots.scaled(factor))


def range_increase(per_metre: float) -> float:
    """
    Return the part by which ranges r of a variance c^2 + p^2 r^2 are to be increased, from p.

    The variance is taken at the measured range, so that ranges that came out short have too much
    weight: their weighted mean is too short by the derivative of the variance, to first order.

    """
    return 2.0 * per_metre ** 2


def bearing_offset(robot: int, options: ConversionOptions) -> tuple[float, float]:
    """Return the angle of a robot's camera and its standard deviation [rad]."""
    return options.bearing_offsets.get(robot, (0.0, OFFSET_SIGMA))
