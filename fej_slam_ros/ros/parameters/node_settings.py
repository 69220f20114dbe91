# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Settings on which the result of an estimation does not depend: what nodes and files read."""

from dataclasses import dataclass, field

from fej_slam_ros.core.parameter_kinds import (
    FLAG, FRAME, NOT_NEGATIVE, numbers, one_of, parameter, PATH, PERIOD, POSITIVE, Range,
    ROBOT_NAMES, TEXTS)
from fej_slam_ros.core.settings import Settings


@dataclass(frozen=True)
class CommonNodeSettings:
    """Parameters of a node that both the estimator and the smoother read."""

    clock_limit: float = parameter(
        1.0, NOT_NEGATIVE,
        'difference between stamps and the clock of reception above which diagnostics warn', 's',
        changeable=True)
    on_time_jump: str = parameter(
        'refuse', one_of('refuse', 'reset'),
        'when time jumps back: refuse all later input, or reset, which starts a new run')
    unused_variance: float = parameter(
        0.0, NOT_NEGATIVE, 'variance of z, roll and pitch in published covariances', 'm^2, rad^2',
        changeable=True)
    map_frame: str = parameter(
        'map', FRAME, 'name of the frame map in messages; result files always say map')
    tf_topics: str = parameter(
        'shared', one_of('shared', 'robot', 'both'),
        'topics of the transforms: /tf, <robot>/tf of each robot, or both')
    transform_tolerance: float = parameter(
        0.1, numbers('a number', Range(0, 3600)),
        'duration by which the stamps of transforms are later than the odometry that they are'
        ' predicted with', 's', changeable=True)
    map_period: float = parameter(
        1.0, PERIOD, 'period of the publication of paths, maps and markers', 's', changeable=True)
    output: str = parameter(
        '', PATH, 'folder for the result files of a live run; empty: no files')
    checkpoint: str = parameter('', PATH, 'file that a live run is saved to; empty: none')
    autosave_period: float = parameter(
        0.0, NOT_NEGATIVE, 'period of saving a live run; 0: only on request', 's',
        changeable=True)
    restore: str = parameter(
        '', PATH,
        "checkpoint to continue from; empty: new run. If it is the file of 'checkpoint' and does"
        ' not exist yet, a new run starts')
    autostart: bool = parameter(
        True, FLAG, 'the node configures and activates itself when it starts')
    strict_parameters: bool = parameter(
        False, FLAG, 'a parameter of an unknown name is an error; false: a warning')

    def shares_tf(self) -> bool:
        """Return whether the transforms of all robots are on one topic."""
        return self.tf_topics != 'robot'


@dataclass(frozen=True)
class SmootherNodeSettings(CommonNodeSettings):
    """Parameters of the node of the smoother."""

    publish_smoothed_tf: bool = parameter(
        False, FLAG,
        'publish the transforms to the odometry frames, which the estimator does unless its'
        ' publish_tf is false: both would contradict each other')
    peers: tuple[str, ...] = parameter(
        (), ROBOT_NAMES,
        'robots that run a smoother of their own, with which this one exchanges measurements when'
        ' they are in reach; robots then has one name', default='none', changeable=True)
    exchange_rate: float = parameter(
        100_000.0, POSITIVE, 'maximum rate of measurements sent to peers', 'bytes/s')
    exchange_period: float = parameter(
        0.5, PERIOD, 'period of the hello messages to peers', 's')
    exchange_file: str = parameter(
        '', PATH, 'file of all measurements known, from which the smoother continues after a'
        ' restart; empty: none')


@dataclass(frozen=True)
class EstimatorNodeSettings(CommonNodeSettings):
    """Parameters of the node of the estimator; the content of a prior map decides the result."""

    prior_landmarks: str = parameter(
        '', PATH,
        'file of surveyed landmarks, or landmarks.csv or checkpoint of an earlier run, that are in'
        ' map from the start; empty: none')
    relative_poses: tuple[str, ...] = parameter(
        (), TEXTS, 'pairs observer:observed of robots whose relative pose is published',
        default='none')
    publish_tf: bool = parameter(
        True, FLAG, 'publish the transforms to the odometry frames')

    def relative_pairs(self) -> list[tuple[str, str]]:
        """Return observer and observed of each published relative pose."""
        pairs = (pair.partition(':') for pair in self.relative_poses)
        return [(observer, observed) for observer, _, observed in pairs]


@dataclass(frozen=True)
class NodeSettings(EstimatorNodeSettings, SmootherNodeSettings):
    """Parameters of the nodes of the estimator and of the smoother."""


@dataclass(frozen=True)
class RunSettings:
    """All that a parameter file gives, or what has become of it in a later run of a process."""

    estimation: Settings  #: what the result depends on
    node: NodeSettings = field(default_factory=NodeSettings)  #: the rest
    #: the estimation that the process was started with, None if it is that of this run
    at_launch: Settings | None = None

    def given(self) -> Settings:
        """Return the settings of estimation that the process was started with."""
        return self.at_launch or self.estimation

    def followed_by(self, estimation: Settings, node: NodeSettings) -> 'RunSettings':
        """Return the settings of a later run of the same process."""
        return RunSettings(estimation, node, self.given())
