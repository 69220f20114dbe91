# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robot-to-robot observations, grouped into rendezvous of two robots."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import NamedTuple

from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.records import NS, RendezvousKey

#: Observations per outlier that may be left out; with fewer, outliers cannot be identified.
MIN_PER_OUTLIER = 10
#: Longest time [ns] without observations within one rendezvous.
MAX_RENDEZVOUS_PAUSE = 20 * NS

#: Names of two robots.
RobotPair = tuple[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousMeasurement:
    """One robot-to-robot observation, a rendezvous-measurement of [Andersson]."""

    #: observer, pose: name of the observer, and index of its pose
    observer: str
    pose: int
    #: observed, observed_pose: name of the observed robot, and index of its pose
    observed: str
    observed_pose: int
    z: Array  #: (2,) array, position of the observed robot in the base frame of the observer [m]
    R: Array  #: (2, 2) array, covariance of z [m^2]
    stamp: int  #: time of both poses [ns]

    @property
    def key(self) -> RendezvousKey:
        """Return observer, observed robot and stamp."""
        return RendezvousKey(self.observer, self.observed, self.stamp)


#: Robot-to-robot observations in the order of time.
Measurements = Sequence[RendezvousMeasurement]


class Rendezvous(NamedTuple):
    """Observations between two robots without a long pause."""

    robots: RobotPair
    measurements: list[RendezvousMeasurement]  #: none if the robots only share landmarks


#: A rendezvous that was not used, and why.
Failed = tuple[Rendezvous, JoinFailure]


def without_few_outliers(
    measurements: Measurements, is_outlier: Sequence[bool]
) -> list[RendezvousMeasurement] | None:
    """Return the measurements without outliers, None if these are too many to identify them."""
    if sum(is_outlier) > len(measurements) // MIN_PER_OUTLIER:
        return None
    return [m for m, wrong in zip(measurements, is_outlier) if not wrong]


def outlier_report(rendezvous: Rendezvous, kept: int) -> JoinFailure:
    """Return the report of a rendezvous of which only a number of observations is kept."""
    count = len(rendezvous.measurements)
    return JoinFailure(
        f'{count - kept} of {count} observations contradict the rest', rendezvous.robots)


def rendezvous_of(maps: Sequence[JointMap], measurements: Measurements) -> list[Rendezvous]:
    """
    Return the rendezvous of each pair of robots, or an empty one if they share landmarks.

    `maps` are those of single robots.

    """
    names = [own.robots[0] for own in maps]
    pairs: dict[RobotPair, list[list[RendezvousMeasurement]]] = {}
    for m in measurements:
        one, other = sorted((m.observer, m.observed), key=names.index)
        sessions = pairs.setdefault((one, other), [])
        if not sessions or m.stamp - sessions[-1][-1].stamp > MAX_RENDEZVOUS_PAUSE:
            sessions.append([])
        sessions[-1].append(m)
    for p, q in combinations(maps, 2):
        if not set(p.landmarks).isdisjoint(q.landmarks):
            pairs.setdefault((p.robots[0], q.robots[0]), [[]])
    return [
        Rendezvous(pair, session) for pair, sessions in pairs.items() for session in sessions]
