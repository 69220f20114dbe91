# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The one vocabulary of the package: what was measured, and when.

Bags, topics, data sets and the simulator all become these records; nothing downstream knows where
a record came from. Stamps are integers of nanoseconds. A record is checked before it is made, so
whoever receives one may trust it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import TypeVar

import numpy as np

from fej_slam_ros.core.geometry import Array

#: Nanoseconds in a second.
NS = 1_000_000_000

#: The number of an observation whose landmark nobody knows.
NO_ID = -1

#: A landmark's identity: its number, and whose number it is ('' where all robots share numbers).
LandmarkKey = tuple[str, int]


@dataclass(frozen=True, slots=True, order=True)
class RendezvousKey:
    """Identity of a place where a robot was seen by another, at a stamp [ns]."""

    observer: str
    seen: str
    stamp: int


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """
    Integrated odometry of one robot.

    Attributes
    ----------
    robot : name of the robot
    stamp : time [ns]
    pose : (3,) array, [x, y, phi] in the frame ``<robot>/odom``; only differences are used
    twist_covariance : (3, 3) array of (vx, vy, wz) in the base frame, or None where unknown

    """

    robot: str
    stamp: int
    pose: Array
    twist_covariance: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """
    A landmark seen from a robot, eq. (7) of [Liu].

    Attributes
    ----------
    id : number of the landmark, `NO_ID` where unknown
    z : (2,) array, its position in the robot's base frame [m], x ahead, y left
    R : (2, 2) array, covariance of z [m^2], positive definite

    """

    id: int
    z: Array
    R: Array


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """All that one robot saw at one stamp [ns]; an empty scan looked and saw nothing."""

    robot: str
    stamp: int
    observations: tuple[Observation, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RobotObservation:
    """
    A robot seen from another.

    Attributes
    ----------
    seen : name of the robot that was seen
    z : (2,) array, the origin of its base frame in the base frame of the seer [m]
    R : (2, 2) array, covariance of z [m^2], positive definite

    """

    seen: str
    z: Array
    R: Array


@dataclass(frozen=True, slots=True, eq=False)
class RobotScan:
    """All that one robot saw of the others at one stamp [ns]."""

    robot: str
    stamp: int
    observations: tuple[RobotObservation, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TruePose:
    """Ground truth of one robot: its pose (3,) in the frame ``map`` at a stamp [ns]."""

    robot: str
    stamp: int
    pose: Array


@dataclass(frozen=True, slots=True, eq=False)
class GpsFix:
    """
    Where GPS says that a robot's antenna is: for comparison, no estimator uses it.

    Attributes
    ----------
    robot : name of the robot
    stamp : time [ns]
    point : (2,) array, east and north in the frame ``map`` [m]
    P : (2, 2) array, its covariance [m^2]

    """

    robot: str
    stamp: int
    point: Array
    P: Array


@dataclass(frozen=True, slots=True, eq=False)
class TrueLandmarks:
    """Ground truth of the map: position (2,) [m] of each landmark by its number, told at stamp."""

    positions: Mapping[int, Array]
    stamp: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """
    What somebody says of where a robot is.

    Attributes
    ----------
    robot : name of the robot
    stamp : time [ns]
    pose : (3,) array, [x, y, phi] in the frame ``map``
    P : (3, 3) array, its covariance, positive definite

    """

    robot: str
    stamp: int
    pose: Array
    P: Array


@dataclass(frozen=True, slots=True, eq=False)
class PriorMap:
    """
    Landmarks whose places are known before anything is measured.

    Attributes
    ----------
    ids : their numbers, which all robots share
    points : (n, 2) array, their positions in the frame ``map`` [m]
    P : (2 n, 2 n) array, their joint covariance [m^2]

    """

    ids: tuple[int, ...]
    points: Array
    P: Array


AnyScan = Scan | RobotScan
Record = Odometry | AnyScan | TruePose | TrueLandmarks | PosePrior

ScanT = TypeVar('ScanT', Scan, RobotScan)
ObservationT = TypeVar('ObservationT', Observation, RobotObservation)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """
    What odometry says of one robot's way to a stamp, eq. (2) of [Liu].

    Attributes
    ----------
    robot : name of the robot
    stamp : time at the end of the motion [ns]
    u : (3,) array, displacement [x, y, phi] in the base frame at the beginning of the motion
    Q : (3, 3) array, its covariance in the same frame

    """

    robot: str
    stamp: int
    u: Array
    Q: Array


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """
    Everything that happened at one stamp, ready for the filter.

    Attributes
    ----------
    stamp : time [ns]
    arrivals : robots whose first odometry this is
    motions : how the other robots came here, in the order of the robots
    scans : what was seen, at most one scan a robot, in the order of the robots
    odometry : where each robot that is here is by its odometry, (3,) arrays as in `Odometry`
    robot_scans : which robots that are here saw which others that are here, at most one scan a
        robot, in the order of the robots

    """

    stamp: int
    arrivals: tuple[str, ...]
    motions: tuple[Motion, ...]
    scans: tuple[Scan, ...]
    odometry: Mapping[str, Array]
    robot_scans: tuple[RobotScan, ...] = ()


def ordered(observations: Iterable[ObservationT]) -> tuple[ObservationT, ...]:
    """
    Return observations in the order of identity, unknown ones last as they come.

    Between equal identities values decide, not arrival.

    """
    return tuple(sorted(observations, key=_by_identity))


def merged(scans: Sequence[ScanT]) -> ScanT:
    """Return scans of one robot at one stamp as one, the same in whatever order they arrived."""
    return replace(scans[0], observations=ordered(
        s for scan in sorted(scans, key=_content) for s in scan.observations))


def scaled(scan: ScanT, scale: float) -> ScanT:
    """Return a scan with standard deviations that are multiplied by a factor."""
    if scale == 1.0:
        return scan
    return replace(scan, observations=tuple(
        replace(observation, R=scale ** 2 * observation.R) for observation in scan.observations))


def fingerprint(record: Odometry | AnyScan | PosePrior) -> int:
    """
    Return a number that is equal exactly where two records say the same, in any order.

    It is the same in every process, unlike Python's own hash.

    """
    return int.from_bytes(blake2b(_content(record), digest_size=8).digest(), 'big')


def _content(record: Odometry | AnyScan | PosePrior) -> bytes:
    if isinstance(record, Odometry):
        covariance = b'' if record.twist_covariance is None else record.twist_covariance.tobytes()
        return record.pose.tobytes() + covariance
    if isinstance(record, PosePrior):
        return np.int64(record.stamp).tobytes() + record.pose.tobytes() + record.P.tobytes()
    if isinstance(record, RobotScan):
        return b''.join(sorted(
            s.seen.encode() + b'\0' + s.z.tobytes() + s.R.tobytes() for s in record.observations))
    return b''.join(sorted(
        s.id.to_bytes(8, 'little', signed=True) + s.z.tobytes() + s.R.tobytes()
        for s in record.observations))


def _by_identity(observation: Observation | RobotObservation) -> tuple[bool, int | str, list[float]]:
    if isinstance(observation, RobotObservation):
        return False, observation.seen, _values(observation)
    if observation.id == NO_ID:
        return True, NO_ID, []
    return False, observation.id, _values(observation)


def _values(observation: Observation | RobotObservation) -> list[float]:
    return [*observation.z.tolist(), *observation.R.ravel().tolist()]
