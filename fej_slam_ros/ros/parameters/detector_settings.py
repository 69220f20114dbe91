# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the detector: what the landmarks and the lasers are like."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fej_slam_ros.core.parameter_kinds import (
    FLAG, NOT_NEGATIVE, numbers, one_of, Parameter, parameter, POSE, POSITIVE, Range,
    ROBOT_NAMES)
from fej_slam_ros.core.settings import Triple
from fej_slam_ros.detection.detector import ScanDetector
from fej_slam_ros.detection.posts import PostDetector
from fej_slam_ros.detection.reflectors import ReflectorDetector
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.messages.laser import MAX_DURATION
from fej_slam_ros.ros.parameters import schema
from fej_slam_ros.ros.parameters.values import front_end_settings, Warn, warn_once
from fej_slam_ros.ros.parameters.yaml_files import load_parsed, load_values, warn_with_path

RADIUS = numbers('a number', Range(0.001, 10.0))
RANGE_SIGMA = numbers('a number', Range(1e-4, 10.0))
BEAM_COUNT = numbers('an integer', Range(1, 1000), element=int)
DURATION = numbers('a number', Range(0.0, MAX_DURATION))


@dataclass(frozen=True)
class LaserRobotSettings:
    """Parameters of one robot."""

    sensor_pose: Triple | None = parameter(
        None, POSE,
        'pose of its only laser in the base frame, instead of static transforms; landmarks are'
        ' then in the frame of the laser: give the estimator the same, and <robot>.sensor_frame',
        'm, m, rad', 'static transforms')
    use_odometry_covariance: bool = parameter(
        True, FLAG,
        'false: the covariance of its odometry is not read, as of the estimator; it is small'
        ' during a scan')


@dataclass(frozen=True)
class DetectorSettings:
    """Parameters of the node ``detector`` and of ``detect``."""

    robots: tuple[str, ...] = parameter(
        (), ROBOT_NAMES, 'names of the robots; each has the topics <robot>/scan, <robot>/odom',
        default='must be given')
    min_radius: float = parameter(0.03, RADIUS, 'smallest radius of a post', 'm')
    max_radius: float = parameter(0.5, RADIUS, 'largest radius of a post', 'm')
    range_sigma: float = parameter(0.03, RANGE_SIGMA, 'standard deviation of a range', 'm')
    max_range: float = parameter(
        100.0, POSITIVE, 'range beyond which nothing is detected', 'm')
    min_beams: int = parameter(
        3, BEAM_COUNT, 'minimum number of beams that meet a landmark; a post needs at least 3')
    static_time: float = parameter(
        0.8, NOT_NEGATIVE,
        'time for which a landmark must have been seen at one place, so that people who walk are'
        ' none; 0: no such test', 's')
    intensity_threshold: float = parameter(
        0.0, NOT_NEGATIVE,
        'minimum intensity of beams that meet a reflector; 0: posts are detected by their shape')
    reflector_radius: float = parameter(
        0.0, NOT_NEGATIVE, 'radius of round reflectors; 0: they are flat', 'm')
    reversed_beams: bool = parameter(
        False, FLAG,
        'the last beam of a scan was measured first, as of RPLIDAR: its driver reverses ranges,'
        ' but not times')
    scan_duration: float = parameter(
        0.0, DURATION,
        'time in which the laser measures all beams of a scan, where the driver leaves'
        ' time_increment at 0 or computes it wrongly, as older ones of LDS-01; 0: by'
        ' time_increment',
        's')
    stamped_at_end: bool = parameter(
        False, FLAG,
        'the stamp of a scan is that of its last beam, as of drivers that stamp a complete scan')
    tf_topics: str = parameter(
        'both', one_of('shared', 'robot', 'both'),
        'topics of the static transforms of the lasers: /tf_static, <robot>/tf_static, or both')
    strict_parameters: bool = parameter(
        False, FLAG, 'a parameter of an unknown name is an error; false: a warning')
    #: parameters of each robot by its name
    of_robots: Mapping[str, LaserRobotSettings] = field(default_factory=dict)

    def method(self) -> ScanDetector:
        """Return what finds the landmarks in a single scan."""
        if self.intensity_threshold > 0.0:
            return ReflectorDetector(
                self.intensity_threshold, self.reflector_radius, self.range_sigma, self.max_range)
        return PostDetector(
            self.min_radius, self.max_radius, self.range_sigma, self.max_range)


def known_parameters(robots: Sequence[str] = ('<robot>',)) -> dict[str, Parameter]:
    """Return the parameters of the detector for some robots by their full names."""
    return schema.full_names(DetectorSettings, LaserRobotSettings, robots)


def parse_detector(values: Mapping[str, object], warn: Warn = warn_once) -> DetectorSettings:
    """Return the settings that flat ROS parameters give."""
    settings: DetectorSettings = front_end_settings(
        values, DetectorSettings, LaserRobotSettings, warn)
    if settings.min_radius > settings.max_radius:
        raise UsageError(
            f'min_radius {settings.min_radius:g} is above max_radius {settings.max_radius:g}:'
            ' exchange them')
    return settings


def load_detector(path: Path) -> DetectorSettings:
    """Return the settings for the node ``detector`` in a ROS parameter file."""
    return load_parsed(path, ['detector'], parse_detector)


def detector_in(path: Path | None, robots: Sequence[str]) -> DetectorSettings:
    """Return the settings for the detector of some robots in a file for other nodes too."""
    warn = warn_with_path(path)
    try:
        values = {} if path is None else load_values(path, ['detector'], warn)
    except UsageError:
        values = {}
    known = known_parameters(robots)
    given = {name: value for name, value in values.items() if name in known}
    return parse_detector({**given, 'robots': [*robots]}, warn)
