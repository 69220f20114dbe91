# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Records: measurements and ground truth with their stamps.

Bags, topics, data sets and the simulator are all converted to these records; the core does not
know the source of a record. Stamps are integers of nanoseconds. Values are checked before a record
is made, so its users need not check them again.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from itertools import pairwise
import math
from typing import TypeVar

import numpy as np

from fej_slam_ros.core.geometry import Array

#: Nanoseconds in a second.
NS = 1_000_000_000

#: ID of an observation whose landmark is unknown.
NO_ID = -1
#: Largest landmark ID and robot ID: IDs are published as int32.
MAX_ID = 2**31 - 1

#: A motion or pose with a larger standard deviation of heading [rad] or position [m], as after a
#: gap in the odometry, is too uncertain to linearise.
MAX_LINEAR_HEADING_SIGMA = 0.3
MAX_LINEAR_POSITION_SIGMA = 1e3
#: Covariance of a pose or a motion that is not known: 1 km, and a turn in either direction.
UNKNOWN_POSE_COVARIANCE = np.diag(np.square([1e3, 1e3, np.pi]))

#: Identity of a landmark: the robot whose ID it is ('' where all robots share IDs), and the ID.
LandmarkKey = tuple[str, int]


@dataclass(frozen=True, slots=True, order=True)
class RendezvousKey:
    """Identity of a rendezvous point: observer, observed robot and stamp [ns]."""

    observer: str
    observed: str
    stamp: int


#: Identity of a point of the joint state.
PointKey = LandmarkKey | RendezvousKey


@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Integrated odometry of one robot."""

    robot: str  #: name of the robot
    stamp: int  #: time [ns]
    #: (3,) array, [x, y, phi] in the frame ``<robot>/odom``; only differences are used
    pose: Array
    #: (3, 3) array of (vx, vy, wz) in the base frame, or None where unknown
    twist_covariance: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Observation of a landmark by a robot, eq. (7) of [Liu]."""

    id: int  #: landmark ID, `NO_ID` if unknown
    z: Array  #: (2,) array, position in the base frame of the robot [m], x ahead, y left
    R: Array  #: (2, 2) array, covariance of z [m^2], positive definite


@dataclass(frozen=True, slots=True, eq=False)
class Scan:
    """Landmark observations of one robot at one stamp [ns], possibly none."""

    robot: str
    stamp: int
    observations: tuple[Observation, ...]


@dataclass(frozen=True, slots=True, eq=False)
class RobotObservation:
    """Observation of a robot by another."""

    observed: str  #: name of the observed robot
    z: Array  #: (2,) array, origin of its base frame in the base frame of the observer [m]
    R: Array  #: (2, 2) array, covariance of z [m^2], positive definite


@dataclass(frozen=True, slots=True, eq=False)
class RobotScan:
    """Robot-to-robot observations of one robot at one stamp [ns]."""

    robot: str
    stamp: int
    observations: tuple[RobotObservation, ...]


@dataclass(frozen=True, slots=True, eq=False)
class TruePose:
    """Ground truth pose (3,) of one robot in ``map`` at a stamp [ns]."""

    robot: str
    stamp: int
    pose: Array


@dataclass(frozen=True, slots=True, eq=False)
class GpsFix:
    """GPS position of the antenna of a robot, for comparison; no estimator uses it."""

    robot: str  #: name of the robot
    stamp: int  #: time [ns]
    point: Array  #: (2,) array, east and north in ``map`` [m]
    P: Array  #: (2, 2) array, covariance of point [m^2]


@dataclass(frozen=True, slots=True, eq=False)
class TrueLandmarks:
    """Ground truth of the map: positions (2,) [m] by landmark ID, published at a stamp [ns]."""

    positions: Mapping[int, Array]
    stamp: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class PosePrior:
    """Initial pose of a robot, given from outside."""

    robot: str  #: name of the robot
    stamp: int  #: time [ns]
    pose: Array  #: (3,) array, [x, y, phi] in ``map``
    P: Array  #: (3, 3) array, covariance of pose, positive definite


@dataclass(frozen=True, slots=True, eq=False)
class PriorMap:
    """Landmarks that are known before the run."""

    ids: tuple[int, ...]  #: landmark IDs, shared by all robots
    points: Array  #: (n, 2) array, positions in ``map`` [m]
    P: Array  #: (2 n, 2 n) array, joint covariance of points [m^2]


AnyScan = Scan | RobotScan
AnyObservation = Observation | RobotObservation
Record = Odometry | AnyScan | TruePose | TrueLandmarks | PosePrior
#: A record and its time of reception [ns], None if it has none.
Received = tuple[Record, int | None]

ScanT = TypeVar('ScanT', Scan, RobotScan)
ObservationT = TypeVar('ObservationT', Observation, RobotObservation)


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Motion of one robot from its last event to a stamp, by odometry, eq. (2) of [Liu]."""

    robot: str  #: name of the robot
    stamp: int  #: time at the end of the motion [ns]
    u: Array  #: (3,) array, displacement [x, y, phi] in the base frame at the begin of the motion
    Q: Array  #: (3, 3) array, covariance of u in the same frame
    impossible: str = ''  #: why the robot cannot have moved so, '' if it can


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """All events at one stamp, as input of a filter or smoother; robots in processing order."""

    stamp: int  #: time [ns]
    arrivals: tuple[str, ...]  #: robots at their first odometry
    motions: tuple[Motion, ...]  #: of the other robots of the step
    scans: tuple[Scan, ...]  #: landmark scans, at most one per robot
    #: odometry poses of the robots of the step, (3,) arrays as in `Odometry`
    odometry: Mapping[str, Array]
    #: robot-to-robot scans among the robots of the step, at most one per robot
    robot_scans: tuple[RobotScan, ...]


def is_too_uncertain(P: Array) -> bool:
    """Return whether a pose or motion with covariance P (3, 3) is too uncertain to linearise."""
    x, y, phi = P.diagonal().tolist()
    return not (
        max(x, y) <= MAX_LINEAR_POSITION_SIGMA ** 2 and phi <= MAX_LINEAR_HEADING_SIGMA ** 2)


def ordered(observations: Iterable[ObservationT]) -> tuple[ObservationT, ...]:
    """
    Return observations in the order of IDs, those without ID last in the given order.

    Equal IDs are ordered by values, so that the order of arrival has no effect.

    """
    return tuple(sorted(observations, key=_by_identity))


def merged(scans: Sequence[ScanT]) -> ScanT:
    """Return the scans of one robot at one stamp as one scan, independent of their order."""
    if len(scans) == 1 and _is_ordered(scans[0].observations):
        return scans[0]
    return replace(scans[0], observations=ordered(
        s for scan in sorted(scans, key=_content) for s in scan.observations))


def fingerprint(record: Odometry | AnyScan | PosePrior) -> int:
    """
    Return a hash of the content of a record, independent of the order of observations.

    Unlike Python's own hash, it is the same in every process.

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
            s.observed.encode() + b'\0' + s.z.tobytes() + s.R.tobytes()
            for s in record.observations))
    return b''.join(sorted(
        s.id.to_bytes(8, 'little', signed=True) + s.z.tobytes() + s.R.tobytes()
        for s in record.observations))


def _is_ordered(observations: Sequence[AnyObservation]) -> bool:
    """Return whether observations are of landmarks in ascending order, each once."""
    ids = [o.id if isinstance(o, Observation) else NO_ID for o in observations]
    return all(NO_ID != id_ < later for id_, later in pairwise((*ids, math.inf)))


def _by_identity(observation: AnyObservation) -> tuple[bool, int | str, list[float]]:
    values = [*observation.z.tolist(), *observation.R.ravel().tolist()]
    if isinstance(observation, RobotObservation):
        return False, observation.observed, values
    return (True, NO_ID, []) if observation.id == NO_ID else (False, observation.id, values)
