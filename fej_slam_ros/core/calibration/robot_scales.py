# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Noise scale factors with their standard errors, and robots whose factors differ from others."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math

#: Largest standard error of a usable factor, relative.
MAX_RELATIVE_ERROR = 0.15
#: Number of standard errors from which on a robot's factor differs from that of the others.
DIFFERENT = 4.0


@dataclass(frozen=True, slots=True)
class NoiseScale:
    """Factor on stated standard deviations."""

    scale: float  #: the factor
    relative_error: float  #: standard error of its logarithm, for independent errors
    samples: int  #: number of errors or innovations

    def is_known(self) -> bool:
        """Return whether there was enough data."""
        return self.relative_error <= MAX_RELATIVE_ERROR

    def distance(self, other: 'NoiseScale') -> float:
        """Return the difference of two factors in standard errors, 0 if one is not known."""
        if not (self.is_known() and other.is_known()):
            return 0.0
        return abs(math.log(self.scale / other.scale)) / math.hypot(
            self.relative_error, other.relative_error)


def different_robots(
    own: Mapping[str, NoiseScale], without: Callable[[set[str]], NoiseScale]
) -> list[str]:
    """Return the robots whose own factors differ from that `without` them, of all but some."""
    found: set[str] = set()
    while True:
        rest = sorted(own.keys() - found)
        distances = {
            robot: own[robot].distance(without(found | {robot}))
            for robot in (rest if len(rest) > 1 else ())}
        # Those of two robots are the same but for rounding.
        robot = max(distances, key=lambda name: round(distances[name], 6), default=None)
        if robot is None or distances[robot] <= DIFFERENT:
            return sorted(found)
        found.add(robot)
