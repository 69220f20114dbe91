# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Settings on which the result of an estimation depends; times in s, lengths in m, angles in rad.

Names, defaults, units, ranges and help of the parameters are declared here, once: a field that is
a `parameter` is a ROS parameter of the same name. ``Common...`` classes hold the parameters of
both the estimator and the smoother; their subclasses add those of one of them.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, fields, KW_ONLY, replace
from typing import Any

import numpy as np

from fej_slam_ros.core.parameter_kinds import (
    BEARING_BIAS, FLAG, FRAME, NOISE_GROWTH, NOISE_SCALE, NOT_NEGATIVE, numbers, ODOMETRY_SCALE,
    one_of, Parameter, parameter, parameters_of, POINT_SIGMA, POSE, POSE_SIGMA, POSITIVE,
    PROBABILITY, Range, RANGE_SCALE, ROBOT_ID, ROBOT_NAMES, SENSOR_DELAY, TEXT, TURN_BIAS)
from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UsageError

Triple = tuple[float, float, float]
#: Pose of a frame in itself.
ORIGIN: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class NoiseSettings:
    """Errors of a robot's sensors; as parameters of the team, the defaults of all its robots."""

    odometry_sigma: Triple = parameter(
        (0.05, 0.05, 0.02), POSE_SIGMA, 'standard deviations of odometry without covariance',
        'm, m, rad per sqrt(s)', changeable=True)
    landmark_sigma: tuple[float, float] = parameter(
        (0.1, 0.1), POINT_SIGMA, 'standard deviations of observations without covariance', 'm',
        changeable=True)
    odometry_scale: tuple[float, float] = parameter(
        (1.0, 1.0), ODOMETRY_SCALE, 'true over measured distance and turn of odometry',
        changeable=True)
    odometry_turn_bias: float = parameter(
        0.0, TURN_BIAS, 'turn rate subtracted from that of odometry, after its scale', 'rad/s',
        changeable=True)
    observation_range_scale: float = parameter(
        1.0, RANGE_SCALE, 'true over measured range of landmarks and robots', changeable=True)
    observation_bearing_bias: float = parameter(
        0.0, BEARING_BIAS, 'angle subtracted from bearings of landmarks and robots', 'rad',
        changeable=True)
    observation_noise_growth: float = parameter(
        0.0, NOISE_GROWTH,
        'increase of the standard deviations of observations with the range: they are multiplied'
        ' by 1 + growth * range', '1/m', changeable=True)
    odometry_noise_scale: float = parameter(
        1.0, NOISE_SCALE,
        'factor on the standard deviations of odometry, received or from odometry_sigma',
        changeable=True)
    landmark_noise_scale: float = parameter(
        1.0, NOISE_SCALE,
        'factor on the standard deviations of landmark observations, received or from'
        ' landmark_sigma', changeable=True)
    robot_noise_scale: float = parameter(
        1.0, NOISE_SCALE,
        'factor on the standard deviations of robot-to-robot observations, received or from'
        ' landmark_sigma', changeable=True)


@dataclass(frozen=True)
class CommonRobotSettings(NoiseSettings):
    """One robot of the team; its name is its namespace."""

    name: str
    id: int = field(metadata=Parameter(
        ROBOT_ID, 'ID of the robot in <robot>/robots clouds',
        default='position in robots, from 1').metadata)
    _: KW_ONLY
    sensor_pose: Triple = parameter(
        ORIGIN, POSE, 'pose of the landmark sensor in the base frame', 'm, m, rad')
    sensor_delay: float = parameter(
        0.0, SENSOR_DELAY,
        'time by which the stamps of landmarks and robots are late; max_delay must be larger', 's')
    sensor_frame: str | None = parameter(
        None, TEXT, 'additional frame name that scans may carry', default='none')
    odom_frame: str | None = parameter(
        None, FRAME, 'odometry frame, to which the transform from map leads',
        default='the frame of the first odometry')
    base_frame: str | None = parameter(
        None, FRAME, 'base frame: of fused odometry, of relative poses, and that scans may carry',
        default='the child frame of the odometry')
    use_odometry_covariance: bool = parameter(
        True, FLAG,
        'false: the covariance of its odometry is not read, and odometry_sigma is used, for'
        ' drivers that fill in invalid or invented numbers')
    max_speed: float = parameter(
        50.0, POSITIVE,
        'speed of odometry beyond which its driver has restarted: the robot restarts in its own'
        ' frame; with 1e9 no motion of it is checked', 'm/s')
    max_turn_rate: float = parameter(
        10.0, POSITIVE, 'the same for the turn rate', 'rad/s')


@dataclass(frozen=True)
class RobotSettings(CommonRobotSettings):
    """One robot of an estimator; its start is unknown where `start_pose` is None."""

    start_pose: Triple | None = parameter(
        None, POSE, 'known initial pose in map', 'm, m, rad', 'unknown')
    start_sigma: Triple = parameter(
        (0.0, 0.0, 0.0), POSE_SIGMA, 'standard deviations of start_pose', 'm, m, rad')


@dataclass(frozen=True)
class CommonSettings(NoiseSettings):
    """
    The team and the handling of its input and frames.

    Estimator and smoother read the noise of each robot, not that of the team.

    """

    robots: tuple[RobotSettings, ...] = field(metadata=Parameter(
        ROBOT_NAMES, 'names of the robots, in the order of processing within a step',
        default='none, required', changeable=True).metadata)
    anchor: str = field(metadata=Parameter(
        TEXT, 'robot whose initial pose defines the frame map; may be empty with prior_landmarks',
        default='first of robots').metadata)
    anchor_pose: Triple = parameter(
        ORIGIN, POSE, 'initial pose of the anchor in map', 'm, m, rad')
    _: KW_ONLY
    anchor_sigma: Triple = parameter(
        (0.0, 0.0, 0.0), POSE_SIGMA, 'standard deviations of anchor_pose', 'm, m, rad')
    gate_probability: float = parameter(
        0.999, PROBABILITY, 'chi-square gate on observations; 1.0 disables it', changeable=True)
    max_delay: float = parameter(
        0.1, NOT_NEGATIVE, 'maximum delay at which data are still processed in order', 's',
        changeable=True)
    stale_after: float = parameter(
        1.0, NOT_NEGATIVE,
        'lag of the odometry of a robot behind another beyond which it is not waited for', 's',
        changeable=True)
    future_limit: float = parameter(
        5.0, NOT_NEGATIVE, 'maximum lead of a stamp over the time of reception', 's',
        changeable=True)
    max_observations: int = parameter(
        500, numbers('an integer', Range(1, 100_000), element=int),
        'maximum number of points in a scan, and of observations of a robot at one stamp; larger'
        ' scans are rejected')
    join_min_landmarks: int = parameter(
        3, numbers('an integer', Range(2, 1000), element=int),
        'minimum number of shared landmarks and robot-to-robot observations to join two frames',
        changeable=True)
    join_probability: float = parameter(
        0.99, PROBABILITY,
        'probability of the chi-square test that accepts a join; 1.0 disables it, the smoother'
        ' takes at least 0.9999', changeable=True)
    shared_landmark_ids: bool = parameter(
        True, FLAG, 'landmark IDs are the same for all robots; false: each robot has its own IDs')

    def is_future(self, stamp: int, received: int | None) -> bool:
        """Return whether a stamp leads its time of reception, both [ns], by too much."""
        return received is not None and stamp - received > self.future_limit * NS


@dataclass(frozen=True)
class SmootherSettings(CommonSettings):
    """The settings of one smoother."""

    keyframe_distance: float = parameter(
        0.0, NOT_NEGATIVE,
        'motion after which a pose, or another observation of the same landmark, is kept; those in'
        ' between correct the newest pose only. 0: all are kept', 'm')


@dataclass(frozen=True)
class EstimatorSettings(CommonSettings):
    """The settings of one estimator."""

    initialpose_robot: str = parameter(
        '', TEXT, 'robot that the topic initialpose of RViz is for', changeable=True,
        default='the only robot; with several, initialpose is not used')
    filter: str = parameter(
        'fej', one_of('fej', 'invariant', 'standard', 'ideal'),
        'linearisation policy of the filter; ideal needs ground truth')
    update_iterations: int = parameter(
        0, numbers('an integer', Range(0, 100), element=int),
        'minimum number of Gauss-Newton iterations of an update; 0 selects that of the filter, 3'
        ' for invariant and 1 for the others. In frames of single robots, and in map once maps'
        ' have joined, fej makes 2 where a heading is corrected by more than 0.1 rad')
    compressed: bool = parameter(
        True, FLAG,
        'steps in a large map update only the submap around the robots, without approximation')
    start_covariance: str = parameter(
        'anchored', one_of('anchored', 'independent'),
        'anchored: poses started at step 0 are correlated with an uncertain anchor; independent:'
        ' they are not, as in [Liu], which is overconfident')
    match_probability: float = parameter(
        0.99, PROBABILITY,
        'probability with which a correct match of an observation without ID (-1) passes its'
        ' chi-square test', changeable=True)
    inflate_rejected_scans: bool = parameter(
        False, FLAG, 'if most of a scan fails the gate, inflate its noise and gate it again',
        changeable=True)
    max_landmarks: int = parameter(
        2500, numbers('an integer', Range(1, 100_000), element=int),
        'maximum number of landmarks of all maps, beyond which no new ones are started; n of them'
        ' take 32 n^2 bytes')
    moved_landmarks: str = parameter(
        'report', one_of('report', 'forget', 'ignore'),
        'handling of landmarks that repeatedly fail the gate', changeable=True)
    join_heading_sigma: float = parameter(
        0.1, NOT_NEGATIVE,
        'maximum standard deviation of the heading between two frames that join', 'rad',
        changeable=True)


@dataclass(frozen=True)
class Settings(EstimatorSettings, SmootherSettings):
    """The settings of either of them."""


def numbered_robots(names: Iterable[str]) -> tuple[RobotSettings, ...]:
    """Return robots with the default settings; their IDs are their positions, from 1."""
    return tuple(RobotSettings(name, id_) for id_, name in enumerate(names, start=1))


def with_equal_noise(settings: Settings, **noise: Any) -> Settings:
    """Return settings with some fields of `NoiseSettings` that are the same for all robots."""
    robots = tuple(replace(robot, **noise) for robot in settings.robots)
    return replace(settings, robots=robots, **noise)


def check_values(settings: Settings) -> None:
    """Raise a UsageError for an impossible value of settings or of one of their robots."""
    names = [robot.name for robot in settings.robots]
    if len({*names}) < len(names):
        raise UsageError(f'two robots of {", ".join(map(repr, names))} have one name: rename one')
    _check_kinds(settings, '')
    for robot in settings.robots:
        _check_kinds(robot, f'{robot.name}.')
    check_anchor(settings)


def check_anchor(settings: CommonSettings) -> None:
    """Raise a UsageError for an anchor that is none of the robots."""
    names = [robot.name for robot in settings.robots]
    if settings.anchor not in {'', *names}:
        raise UsageError(
            f"'anchor' must be one of {', '.join(map(repr, names))}, not {settings.anchor!r}")


def _check_kinds(settings: Settings | RobotSettings, owner: str) -> None:
    """Raise a UsageError for a value that is not of the kind of its parameter."""
    optional = {f.name for f in fields(settings) if f.default is None}
    for name, declared in parameters_of(type(settings)).items():
        value = getattr(settings, name)
        if name == 'robots' or (value is None and name in optional):
            continue
        # In Python, arrays and numbers of numpy are values too.
        if declared.kind.read(np.asarray(value).tolist()) is None:
            raise UsageError(f"'{owner}{name}' must be {declared.kind.expected}, not {value!r}")
