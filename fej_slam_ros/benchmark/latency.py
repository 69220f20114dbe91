# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How long poses take, from the sending of what they rest on to their reception."""

from dataclasses import dataclass, field

import numpy as np

from fej_slam_ros.benchmark.load import Load
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.session.percentiles import Percentiles, percentiles

#: A robot and a stamp [ns].
Event = tuple[str, int]


@dataclass
class Traffic:
    """
    What was sent to an estimator, and heard of it.

    Attributes
    ----------
    messages : how many were sent
    sent, heard : for each event, when [ns] its last message was sent and its pose received
    cpu : part of one processor that the estimator took while messages were sent
    report : what diagnostics of the estimator said last, by part and key

    """

    messages: int = 0
    sent: dict[Event, int] = field(default_factory=dict)
    heard: dict[Event, int] = field(default_factory=dict)
    cpu: float = 0.0
    report: dict[str, dict[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class LiveTime:
    """
    What became of a load.

    Attributes
    ----------
    robots, odometry_rate : how many robots send how much odometry a second
    sent, received, used : how many messages
    steps, poses : how many poses were due and came
    cpu : part of one processor that the estimator took
    latency : how late poses were [s], beyond `max_delay` after what they rest on was sent
    waited : as part of that, how long the odometry was waited for that let them go

    """

    robots: int
    odometry_rate: int
    sent: int
    received: int
    used: int
    steps: int
    poses: int
    cpu: float
    latency: Percentiles
    waited: Percentiles


def live_time(load: Load, traffic: Traffic, max_delay: float) -> LiveTime:
    """Return what became of a load; max_delay is that of the estimator [s]."""
    released = releases(traffic, max_delay)
    # What only the end of the input released was not late.
    of_input = np.isfinite(released)
    heard = np.array([*traffic.heard.values()])[of_input]
    sent = np.array([traffic.sent[event] for event in traffic.heard])[of_input]

    def count(key: str) -> int:
        return sum(int(values.get(key, 0)) for values in traffic.report.values())

    return LiveTime(
        load.robots, load.odometry_rate, traffic.messages, count('received'), count('used'),
        len(traffic.sent), len(traffic.heard), traffic.cpu,
        percentiles((heard - sent) / NS - max_delay),
        percentiles((released[of_input] - sent) / NS - max_delay))


def releases(traffic: Traffic, max_delay: float) -> Array:
    """
    Return when the odometry of every robot had passed each event heard of by `max_delay` [ns].

    It is infinite where the input ended before.

    """
    needed = np.array([stamp for _, stamp in traffic.heard]) + round(max_delay * NS)
    released = np.zeros(len(needed))
    for robot in {robot for robot, _ in traffic.sent}:
        own = sorted((s, at) for (name, s), at in traffic.sent.items() if name == robot)
        stamps = np.array([stamp for stamp, _ in own])
        times = np.array([*(float(at) for _, at in own), np.inf])
        released = np.maximum(released, times[np.searchsorted(stamps, needed, side='right')])
    return released
