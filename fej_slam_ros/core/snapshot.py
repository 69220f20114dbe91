# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Snapshots: the complete state of an estimator or a smoother as plain data, and back, bit for bit.

Objects are stored as class name and attributes. Only the classes of `SNAPSHOT_CLASSES` are saved
and restored, so that a file can neither name another class nor import a module. Settings are not
stored; they are passed to `restore`.

None, numbers, strings, lists and arrays are stored as they are, everything else as a dict with one
entry, whose key is the kind of the value.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cached_property
from hashlib import sha256
from types import NoneType
from typing import Any, TypeVar

import numpy as np

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.csam.base_node import BaseNode
from fej_slam_ros.core.csam.keyframes import Keyframes
from fej_slam_ros.core.csam.map_merging import ScaledJoin
from fej_slam_ros.core.csam.odometry_links import ReleasedOdometry
from fej_slam_ros.core.csam.outlier_removal import Outlier
from fej_slam_ros.core.csam.rendezvous import RendezvousMeasurement
from fej_slam_ros.core.csam.robot_trajectory import RobotTrajectory
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import SmoothedMap, SmoothedTrajectory, TeamMap
from fej_slam_ros.core.data_association.failure_detection import (
    ContradictionsByOthers, LostRobot, LostRobotDetector, ScanEvidence)
from fej_slam_ros.core.data_association.landmark_manager import FieldOfView, LandmarkManager
from fej_slam_ros.core.ekf.active_submap import ActiveSubmap
from fej_slam_ros.core.ekf.compressed_covariance import CompressedCovariance
from fej_slam_ros.core.ekf.consecutive_rejections import (
    ConsecutiveRejections, RejectedInARow)
from fej_slam_ros.core.ekf.covariance import Covariance, Slot
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate, InflatingGate, ScanGateStatistics
from fej_slam_ros.core.ekf.landmark_evidence import MovedLandmarkEvidence, TentativeEvidence
from fej_slam_ros.core.ekf.linearization import (
    FirstEstimates, Ideal, Invariant, RenewedFirstEstimates, Standard)
from fej_slam_ros.core.ekf.outside_points import OutsidePoints, TurningPoints
from fej_slam_ros.core.ekf.state import JointState, Landmark, RendezvousPoint, Robot
from fej_slam_ros.core.ekf.symmetric_matrix import SymmetricMatrix
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_groups import FrameGroup, FrameGroups
from fej_slam_ros.core.ground_truth import LocalTruth, RecordedTruth
from fej_slam_ros.core.innovation_monitor import InnovationMonitor
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.map_joining import MapJoiner
from fej_slam_ros.core.ordering.impossible_motion import Speeds
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.odometry_increments import OdometryIncrements
from fej_slam_ros.core.ordering.pose_priors import PosePriors
from fej_slam_ros.core.ordering.record_memory import RecordMemory
from fej_slam_ros.core.ordering.robot_queue import ReleaseKey, RobotQueue
from fej_slam_ros.core.ordering.sequencer import Sequencer
from fej_slam_ros.core.pose_evaluation import PoseEvaluation, PoseScore
from fej_slam_ros.core.quarantine import Quarantine
from fej_slam_ros.core.records import (
    Motion, Observation, Odometry, PosePrior, RendezvousKey, RobotObservation, RobotScan, Scan,
    TruePose)
from fej_slam_ros.core.rejections import Rejection, RejectionReason
from fej_slam_ros.core.settings import CommonSettings, RobotSettings
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, OdometryFactors, Values
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.newest_pose import NearMarginal, NewestPose
from fej_slam_ros.core.team_joiner import TeamJoiner

Plain = Any
#: An estimator or a smoother.
ConsumerT = TypeVar('ConsumerT', Estimator, TeamSmoother)

#: All classes that a snapshot may contain.
SNAPSHOT_CLASSES: tuple[type, ...] = (
    Estimator, FrameGroups, FrameGroup, TeamJoiner, InnovationMonitor, Quarantine,
    Sequencer, RobotQueue, ReleaseKey, OdometryIncrements, Speeds, RecordMemory, PosePriors,
    InputStatistics,
    Filter, JointState, Covariance, CompressedCovariance, OutsidePoints,
    TurningPoints, SymmetricMatrix, Slot, Robot, Landmark,
    RendezvousPoint, MovedLandmarkEvidence, TentativeEvidence, ActiveSubmap, Gate, InflatingGate,
    ScanGateStatistics,
    Standard, FirstEstimates, RenewedFirstEstimates, Ideal, Invariant,
    LandmarkManager, FieldOfView, LostRobotDetector, ContradictionsByOthers, ScanEvidence,
    LostRobot, ConsecutiveRejections, RejectedInARow, MapJoiner,
    NisMonitor, PoseEvaluation, PoseScore, RecordedTruth, LocalTruth,
    Odometry, Scan, Observation, RobotScan, RobotObservation, PosePrior, TruePose, RendezvousKey,
    Rejection, RejectionReason, RobotSettings,
    TeamSmoother, Keyframes, RobotTrajectory, IncrementalSmoother, NewestPose, NearMarginal,
    Values, OdometryFactors, LandmarkFactors, Motion, RendezvousMeasurement,
    TeamMap, SmoothedMap, SmoothedTrajectory, BaseNode, JoinFailure, Outlier,
    ReleasedOdometry, ScaledJoin,
)

CORE = 'fej_slam_ros.core.'
PLAIN = {NoneType, bool, int, float, str, np.ndarray}
SEQUENCES: dict[str, Any] = {'tuple': tuple, 'set': set}
MAPPINGS: dict[str, Any] = {'dict': dict, 'Counter': Counter}
#: Default factories that a defaultdict may have.
FACTORIES: dict[str, Any] = {'list': list, 'Counter': Counter}


def snapshot(consumer: Estimator | TeamSmoother) -> Plain:
    """Return the state of an estimator or a smoother without its settings, arrays not copied."""
    return to_plain(consumer, consumer.settings)


def restore(plain: Plain, settings: CommonSettings, kind: type[ConsumerT]) -> ConsumerT:
    """
    Return the estimator or smoother of a snapshot, under the settings it was taken with.

    Raises ValueError for a class or an attribute that snapshots do not have, and TypeError for a
    snapshot of another kind.
    """
    consumer = from_plain(plain, settings)
    if not isinstance(consumer, kind):
        raise TypeError(f'not a snapshot of {kind.__name__}')
    consumer.resume()
    return consumer


def to_plain(value: object, settings: CommonSettings) -> Plain:
    """Return a value, of the classes of `SNAPSHOT_CLASSES`, as plain data without settings."""
    return _Encoder(settings).plain(value)


def from_plain(plain: Plain, settings: CommonSettings) -> Any:
    """Return the value of `to_plain`; errors as of `restore`."""
    return _Decoder(settings).value(plain)


def schema_digest() -> str:
    """Return the SHA-256 of the names and attributes of `SNAPSHOT_CLASSES`."""
    lines = sorted(f'{_name(cls)}: {sorted(attributes_of(cls))}' for cls in SNAPSHOT_CLASSES)
    return sha256('\n'.join(lines).encode()).hexdigest()


def attributes_of(cls: Any) -> set[str]:
    """Return the names that an object of a class may have, or the values of an enum."""
    if issubclass(cls, Enum):
        return {member.value for member in cls}
    if issubclass(cls, tuple):
        return set(cls._fields)
    if is_dataclass(cls):
        return {field.name for field in fields(cls)}
    # Of other classes, all names in __init__, and cached properties.
    members = [member for base in cls.__mro__[:-1] for member in vars(base).items()]
    used = (init.__code__.co_names for name, init in members if name == '__init__')
    cached = {name for name, member in members if isinstance(member, cached_property)}
    return cached.union(*used)


class _Encoder:
    """Converts values to plain data; an object met again is stored as its number."""

    def __init__(self, settings: CommonSettings) -> None:
        self._numbers = {id(known): k for k, known in enumerate((settings, *settings.robots))}

    def plain(self, value: Any) -> Plain:
        if type(value) in PLAIN:
            return value
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, list):
            return self._each(value)
        if isinstance(value, Enum):
            return {'call': [_listed_name(type(value)), [value.value]]}
        if isinstance(value, deque):
            return {'deque': [value.maxlen, self._each(value)]}
        if isinstance(value, defaultdict):
            factory = next(n for n, f in FACTORIES.items() if f is value.default_factory)
            return {'defaultdict': [factory, self._pairs(value)]}
        if isinstance(value, SymmetricMatrix):
            return {'symmetric_matrix': self._each(value.packed())}
        name = type(value).__name__
        if name in SEQUENCES:
            return {name: self._each(value)}
        if isinstance(value, tuple):
            return {'call': [_listed_name(type(value)), self._each(value)]}
        return {name: self._pairs(value)} if name in MAPPINGS else self._object(value)

    def _object(self, value: object) -> Plain:
        if id(value) in self._numbers:
            return {'same': self._numbers[id(value)]}
        self._numbers[id(value)] = len(self._numbers)
        name = _listed_name(type(value))
        attributes = (
            [field.name for field in fields(value)] if is_dataclass(value) else
            getattr(type(value), '__slots__', None) or vars(value))
        return {'object': [name, {a: self.plain(getattr(value, a)) for a in attributes}]}

    def _each(self, values: Iterable[object]) -> list[Plain]:
        return [self.plain(value) for value in values]

    def _pairs(self, values: dict[Any, Any]) -> list[Plain]:
        return [[self.plain(key), self.plain(value)] for key, value in values.items()]


class _Decoder:
    """Converts plain data back; objects appear, and are numbered, in the same order."""

    def __init__(self, settings: CommonSettings) -> None:
        self._objects: list[Any] = [settings, *settings.robots]
        self._classes: dict[str, Any] = {_name(cls): cls for cls in SNAPSHOT_CLASSES}

    def value(self, plain: Plain) -> Any:
        if isinstance(plain, list):
            return self._each(plain)
        if not isinstance(plain, dict):
            return plain
        (kind, content), = plain.items()
        if kind in SEQUENCES:
            return SEQUENCES[kind](self._each(content))
        if kind in MAPPINGS:
            return MAPPINGS[kind](dict(self._each(content)))
        match kind, content:
            case 'call', [name, arguments]:
                return self._value_class(name)(*self._each(arguments))
            case 'deque', [maxlen, values]:
                return deque(self._each(values), maxlen)
            case 'defaultdict', [factory, pairs]:
                return defaultdict(FACTORIES[factory], self._each(pairs))
            case 'symmetric_matrix', [capacity, triangle, propagated]:
                return SymmetricMatrix(capacity, triangle, self.value(propagated))
            case 'same', number:
                return self._objects[number]
        return self._object(*content)

    def _object(self, name: str, attributes: dict[str, Plain]) -> Any:
        cls = self._class(name)
        unknown = attributes.keys() - attributes_of(cls)
        if unknown:
            raise ValueError(f'{name} has no attribute {min(unknown)}')
        value = cls.__new__(cls)
        self._objects.append(value)
        for attribute, plain in attributes.items():
            # Frozen records do not allow plain assignment.
            object.__setattr__(value, attribute, self.value(plain))
        return value

    def _class(self, name: str) -> Any:
        if name not in self._classes:
            raise ValueError(f'unknown class {name!r}')
        return self._classes[name]

    def _value_class(self, name: str) -> Any:
        """Return an enum or a class of tuples; others are not called, since they may compute."""
        if issubclass(self._class(name), (Enum, tuple)):
            return self._class(name)
        raise ValueError(f'{name} is not a class of values')

    def _each(self, plains: list[Plain]) -> list[Any]:
        return [self.value(plain) for plain in plains]


def _name(cls: type) -> str:
    return f'{cls.__module__.removeprefix(CORE)}.{cls.__qualname__}'


def _listed_name(cls: type) -> str:
    if cls not in SNAPSHOT_CLASSES:
        raise TypeError(f'{cls.__qualname__} is not one of SNAPSHOT_CLASSES')
    return _name(cls)
