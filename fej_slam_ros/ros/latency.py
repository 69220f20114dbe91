# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long poses take, from the sending of what they rest on to their reception."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.geometry import Array

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


def beyond_delay(
    sent: Mapping[Event, int], heard: Mapping[Event, int], max_delay: float
) -> Array:
    """
    Return by how much poses came later [s] than `max_delay` after what they rest on.

    Parameters
    ----------
    sent : when odometry and scan of a stamp were sent [ns]
    heard : when the pose of that stamp was received [ns]
    max_delay : for which the estimator holds everything back [s]

    """
    return np.array([(heard[event] - sent[event]) * 1e-9 for event in heard]) - max_delay


def beyond_release(
    sent: Mapping[Event, int], heard: Mapping[Event, int], max_delay: float
) -> Array:
    """
    Return by how much poses came later [s] than the odometry that released them was sent.

    A step at t is released when the odometry of every robot has passed t + `max_delay`.

    """
    stamps = np.array([stamp for _, stamp in heard])
    released = np.zeros(len(stamps))
    for robot in {robot for robot, _ in sent}:
        own = np.array(sorted(stamp for name, stamp in sent if name == robot))
        at = np.array([sent[robot, stamp] for stamp in own.tolist()])
        after = np.searchsorted(own, stamps + round(max_delay * 1e9), side='right')
        # What the end of the input released is of no interest.
        released = np.maximum(released, np.append(at, np.inf)[after])
    late = (np.array([*heard.values()]) - released) * 1e-9
    return late[np.isfinite(late)]
