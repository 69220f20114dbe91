# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scans of the observations that a file lists for one robot and stamp."""

from collections.abc import Iterable, Iterator

from fej_slam_ros.core.records import NO_ID, Observation, ObservationT, RobotObservation
from fej_slam_ros.core.settings import Settings

#: What two observations that repeat each other have in common.
Content = tuple[int | str, bytes, bytes]


def divided(observations: Iterable[ObservationT]) -> Iterator[tuple[ObservationT, ...]]:
    """
    Yield observations as scans, of which each observes a landmark or robot once.

    Files do not separate the scans of several sensors at one stamp. No scan has more observations
    than the default of `max_observations`, beyond which all would be rejected. Without any
    observation there is one empty scan.
    """
    scan: list[ObservationT] = []
    observed: set[int | str] = set()
    for observation in observations:
        name = observed_name(observation)
        if name in observed or len(scan) == Settings.max_observations:
            yield tuple(scan)
            scan, observed = [], set()
        scan.append(observation)
        if name != NO_ID:
            observed.add(name)
    yield tuple(scan)


def distinct(observations: Iterable[ObservationT]) -> list[ObservationT]:
    """Return the observations of one pose without those that repeat another."""
    return list({content(s): s for s in observations}.values())


def content(observation: Observation | RobotObservation) -> Content:
    """Return name, position and noise of an observation."""
    return observed_name(observation), observation.z.tobytes(), observation.R.tobytes()


def observed_name(observation: Observation | RobotObservation) -> int | str:
    """Return the ID of the observed landmark, or the name of the observed robot."""
    return observation.id if isinstance(observation, Observation) else observation.observed
