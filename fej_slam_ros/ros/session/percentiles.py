# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Median, 99th percentile and maximum of measured times."""

from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array


@dataclass(frozen=True)
class Percentiles:
    """Median, 99th percentile and maximum of times [s]."""

    median: float
    p99: float
    longest: float


def percentiles(times: Array) -> Percentiles:
    """Return the percentiles of times [s]; zeros for none."""
    if len(times) == 0:
        return Percentiles(0.0, 0.0, 0.0)
    median, p99 = np.percentile(times, [50, 99]).tolist()
    return Percentiles(median, p99, float(times.max()))
