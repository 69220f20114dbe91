# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the detector: what the landmarks and the lasers are like."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

from fej_slam_ros.core.parameter_kinds import (
    FLAG, NOT_NEGATIVE, numbers, one_of, Parameter, parameter, parameters_of, POSITIVE, Range,
    ROBOT_NAMES)
from fej_slam_ros.detection.detector import ScanDetector
from fej_slam_ros.detection.posts import PostDetector
from fej_slam_ros.detection.reflectors import ReflectorDetector
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.parameters.schema import Value
from fej_slam_ros.ros.parameters.values import given_values, robot_names, Warn, warn_once
from fej_slam_ros.ros.parameters.yaml_files import load_parsed, load_values

RADIUS = numbers('a number', Range(0.001, 10.0))
SIGMA = numbers('a number', Range(1e-4, 10.0))
COUNT = numbers('an integer', Range(1, 1000), element=int)


@dataclass(frozen=True)
class DetectorSettings:
    """Parameters of the node ``detector`` and of ``detect``."""

    robots: tuple[str, ...] = parameter(
        (), ROBOT_NAMES, 'names of the robots; each has the topics <robot>/scan, <robot>/odom',
        default='must be given')
    min_radius: float = parameter(0.03, RADIUS, 'smallest radius of a post', 'm')
    max_radius: float = parameter(0.5, RADIUS, 'largest radius of a post', 'm')
    range_sigma: float = parameter(0.03, SIGMA, 'standard deviation of a range', 'm')
    max_range: float = parameter(
        100.0, POSITIVE, 'range beyond which nothing is detected', 'm')
    min_beams: int = parameter(
        3, COUNT, 'minimum number of beams that meet a landmark; a post needs at least 3')
    static_time: float = parameter(
        0.8, NOT_NEGATIVE,
        'time for which a landmark must have been seen at one place, so that people who walk are'
        ' none; 0: no such test', 's')
    intensity_threshold: float = parameter(
        0.0, NOT_NEGATIVE,
        'minimum intensity of beams that meet a reflector; 0: posts are detected by their shape')
    reflector_radius: float = parameter(
        0.0, NOT_NEGATIVE, 'radius of round reflectors; 0: they are flat', 'm')
    tf_topics: str = parameter(
        'both', one_of('shared', 'robot', 'both'),
        'topics of the static transforms of the lasers: /tf_static, <robot>/tf_static, or both')
    strict_parameters: bool = parameter(
        False, FLAG, 'a parameter of an unknown name is an error; false: a warning')

    def method(self) -> ScanDetector:
        """Return what finds the landmarks in a single scan."""
        if self.intensity_threshold > 0.0:
            return ReflectorDetector(
                self.intensity_threshold, self.reflector_radius, self.range_sigma, self.max_range)
        return PostDetector(
            self.min_radius, self.max_radius, self.range_sigma, self.max_range)


DETECTOR_PARAMETERS: Mapping[str, Parameter] = parameters_of(DetectorSettings)


def parse_detector(values: Mapping[str, object], warn: Warn = warn_once) -> DetectorSettings:
    """Return the settings that flat ROS parameters give."""
    robot_names(values.get('robots', []))
    settings = DetectorSettings(**given_values(values, DETECTOR_PARAMETERS, warn))
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
    try:
        values = {} if path is None else load_values(path, ['detector'])
    except UsageError:
        values = {}
    known = {name: value for name, value in values.items() if name in DETECTOR_PARAMETERS}
    return parse_detector({**known, 'robots': [*robots]})


def detector_values(settings: DetectorSettings) -> dict[str, Value]:
    """Return the settings as flat ROS parameters."""
    return {
        field.name: DETECTOR_PARAMETERS[field.name].kind.write(getattr(settings, field.name))
        for field in fields(settings)}
