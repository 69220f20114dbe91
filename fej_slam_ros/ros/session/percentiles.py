# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How times are spread."""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array


@dataclass(frozen=True)
class Spread:
    """Half of all times [s] are below the median, 99 % below p99."""

    median: float
    p99: float
    longest: float


def spread(times: Array) -> Spread:
    """Return how times [s] are spread; zero where there are none."""
    if len(times) == 0:
        return Spread(0.0, 0.0, 0.0)
    median, p99 = np.percentile(times, [50, 99]).tolist()
    return Spread(median, p99, float(times.max()))
