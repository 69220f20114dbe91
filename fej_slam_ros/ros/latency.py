# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long poses take, from the sending of what they rest on to their reception."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS

#: A robot and a stamp [ns].
Event = tuple[str, int]


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


def releases(
    sent: Mapping[Event, int], heard: Mapping[Event, int], max_delay: float
) -> Array:
    """
    Return when each pose was released [ns]: the odometry of every robot had passed `max_delay`.

    It is infinite for those that only the end of the input released.

    Parameters
    ----------
    sent : when odometry and scan of a stamp were sent [ns]
    heard : when the pose of that stamp was received [ns]
    max_delay : for which the estimator holds everything back [s]

    """
    needed = np.array([stamp for _, stamp in heard]) + round(max_delay * NS)
    released = np.zeros(len(needed))
    for robot in {robot for robot, _ in sent}:
        stamps = np.array(sorted(stamp for name, stamp in sent if name == robot))
        times = np.array([*(float(sent[robot, stamp]) for stamp in stamps.tolist()), np.inf])
        released = np.maximum(released, times[np.searchsorted(stamps, needed, side='right')])
    return released


def latencies(
    sent: Mapping[Event, int], heard: Mapping[Event, int], max_delay: float
) -> tuple[Array, Array]:
    """
    Return how late poses were [s]: beyond `max_delay` and, as part of that, beyond their release.

    Parameters are those of `releases`.

    """
    released = releases(sent, heard, max_delay)
    counts = np.isfinite(released)
    at = np.array([*heard.values()])[counts]
    begun = np.array([sent[event] for event in heard])[counts]
    return (at - begun) / NS - max_delay, (at - released[counts]) / NS
