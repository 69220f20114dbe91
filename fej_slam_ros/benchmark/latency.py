# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Latency of live poses: from sending the measurements to receiving the pose."""

from dataclasses import dataclass, field

import numpy as np

from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.session.percentiles import Percentiles, percentiles

#: A robot and a stamp [ns].
StampedRobot = tuple[str, int]


@dataclass
class Traffic:
    """Messages to an estimator and from it."""

    messages: int = 0  #: Number of sent messages
    #: Time [ns] at which the last message of a robot and stamp was sent.
    sent: dict[StampedRobot, int] = field(default_factory=dict)
    #: Time [ns] at which its pose was received.
    received: dict[StampedRobot, int] = field(default_factory=dict)
    cpu: float = 0.0  #: CPU load of the estimator while messages were sent, 1 is one processor
    #: Latest diagnostics of the estimator, by part and key.
    diagnostics: dict[str, dict[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class LiveTime:
    """Message counts, CPU load and latency of an estimator under a load."""

    #: Number of robots, and odometry messages of each per second.
    robots: int
    odometry_rate: int
    #: Number of messages that were sent, received by the estimator, and used.
    sent: int
    received: int
    used: int
    #: Number of steps, and of received poses.
    steps: int
    poses: int
    cpu: float  #: CPU load of the estimator, 1 is one processor
    latency: Percentiles  #: From sending a step's messages to its pose [s], less `max_delay`
    waited: Percentiles  #: Part of it until the odometry that releases the step is sent [s]


def live_time(load: Load, traffic: Traffic, max_delay: float) -> LiveTime:
    """Return the results of a load; max_delay is that of the estimator [s]."""
    released = releases(traffic, max_delay)
    # Steps that only the end of the input released have no latency.
    is_regular = np.isfinite(released)
    received = np.array([*traffic.received.values()])[is_regular]
    sent = np.array([traffic.sent[event] for event in traffic.received])[is_regular]

    def count(key: str) -> int:
        return sum(int(values.get(key, 0)) for values in traffic.diagnostics.values())

    return LiveTime(
        load.robots, load.odometry_rate, traffic.messages, count('received'), count('used'),
        len(traffic.sent), len(traffic.received), traffic.cpu,
        percentiles((received - sent) / NS - max_delay),
        percentiles((released[is_regular] - sent) / NS - max_delay))


def releases(traffic: Traffic, max_delay: float) -> Array:
    """
    Return the time [ns] at which each received pose could be released.

    That is when the odometry of every robot has passed its stamp by `max_delay`; infinite if the
    input ended before.
    """
    needed = np.array([stamp for _, stamp in traffic.received]) + round(max_delay * NS)
    released = np.zeros(len(needed))
    for robot in {robot for robot, _ in traffic.sent}:
        own = sorted((s, at) for (name, s), at in traffic.sent.items() if name == robot)
        stamps = np.array([stamp for stamp, _ in own])
        times = np.array([*(float(at) for _, at in own), np.inf])
        released = np.maximum(released, times[np.searchsorted(stamps, needed, side='right')])
    return released
