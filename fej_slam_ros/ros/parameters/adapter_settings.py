# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters of the adapter: which messages it reads, and how exact they are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
import re

from fej_slam_ros.core.parameter_kinds import (
    FLAG, FRAME, Kind, NOT_NEGATIVE, numbers, one_of, Parameter, parameter, PATH, POSITIVE,
    Range, ROBOT_ID, ROBOT_NAMES, TEXT, TEXTS)
from fej_slam_ros.detection.objects import ObjectNoise
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.messages.object_formats import FORMATS, ObjectFormat
from fej_slam_ros.ros.parameters import schema
from fej_slam_ros.ros.parameters.values import front_end_settings, Warn, warn_once
from fej_slam_ros.ros.parameters.yaml_files import load_parsed

FORMAT_NAMES = Kind(
    f'a list of some of {", ".join(map(repr, FORMATS))}', str, (None,), FORMATS.__contains__)
SPATIAL_POSE = replace(
    numbers('six numbers [x, y, z, roll, pitch, yaw]', Range(-1e3, 1e3), (6,)), angles=3)
ANGLE_SIGMA = numbers('a number', Range(1e-5, 1.0))
LENGTH_SIGMA = numbers('a number', Range(1e-5, 10.0))
SIGMA_GROWTH = numbers('a number', Range(0.0, 10.0))


@dataclass(frozen=True)
class SensedRobotSettings:
    """Parameters of one robot."""

    id: int | None = parameter(
        None, ROBOT_ID, 'ID in <robot>/robots, as at the estimator', '',
        'position in robots, from 1')
    sensor_pose: tuple[float, ...] | None = parameter(
        None, SPATIAL_POSE,
        'pose of its only sensor on the robot, instead of static transforms; a camera that looks'
        ' ahead has roll -1.5708 and yaw -1.5708 in its optical frame', 'm, rad',
        'static transforms')
    base_frame: str | None = parameter(
        None, FRAME, 'base frame of the robot', '', 'child frame of its odometry')
    tags: tuple[str, ...] = parameter(
        (), TEXTS, 'names of the tags that the robot carries, as in the messages, or numbers', '',
        'none')
    tag_depth: float = parameter(
        0.0, NOT_NEGATIVE,
        'distance of the base frame behind the face of each of these tags', 'm')


@dataclass(frozen=True)
class AdapterSettings:
    """Parameters of the node ``adapter`` and of ``adapt``."""

    robots: tuple[str, ...] = parameter(
        (), ROBOT_NAMES, 'names of the robots', default='must be given')
    formats: tuple[str, ...] = parameter(
        ('apriltag',), FORMAT_NAMES, 'messages that are read', default="['apriltag']")
    names: str = parameter(
        '', TEXT, 'pattern (regular expression) of the names of objects that are used; empty:'
        ' that of the format, which for apriltag is FAMILY:ID, for others everything')
    range_sigma: float = parameter(
        0.02, LENGTH_SIGMA, 'standard deviation of a distance near the sensor, for messages'
        ' without covariances', 'm')
    range_sigma_growth: float = parameter(
        0.01, SIGMA_GROWTH, 'its growth by the square of the distance', '1/m')
    bearing_sigma: float = parameter(
        0.005, ANGLE_SIGMA, 'standard deviation of a direction', 'rad')
    orientation_sigma: float = parameter(
        0.1, ANGLE_SIGMA, 'standard deviation of the orientation of a tag', 'rad')
    max_range: float = parameter(
        100.0, POSITIVE, 'distance beyond which nothing is used', 'm')
    mirrored_axis: str = parameter(
        '', one_of('', 'x', 'y', 'z'),
        'axis to negate where the messages are in a left-handed frame')
    ids_file: str = parameter(
        '', PATH, 'JSON file of the IDs of names, read at the start and completed; empty: none')
    tf_topics: str = parameter(
        'both', one_of('shared', 'robot', 'both'),
        'topics of transforms: /tf and /tf_static, <robot>/tf and <robot>/tf_static, or both')
    strict_parameters: bool = parameter(
        False, FLAG, 'a parameter of an unknown name is an error; false: a warning')
    #: parameters of each robot by its name
    of_robots: Mapping[str, SensedRobotSettings] = field(default_factory=dict)

    def ids(self) -> dict[str, int]:
        """Return the ID of each robot by its name; that of one without is its position."""
        return {
            name: k if of_robot.id is None else of_robot.id
            for k, (name, of_robot) in enumerate(self.of_robots.items(), start=1)}

    def noise(self) -> ObjectNoise:
        """Return the standard deviations of positions."""
        return ObjectNoise(
            self.range_sigma, self.range_sigma_growth, self.bearing_sigma, self.orientation_sigma)

    def object_formats(self) -> list[ObjectFormat]:
        """Return the formats of the messages that are read."""
        return [FORMATS[name] for name in self.formats]


def known_parameters(robots: Sequence[str] = ('<robot>',)) -> dict[str, Parameter]:
    """Return the parameters of the adapter for some robots by their full names."""
    return schema.full_names(AdapterSettings, SensedRobotSettings, robots)


def parse_adapter(values: Mapping[str, object], warn: Warn = warn_once) -> AdapterSettings:
    """Return the settings that flat ROS parameters give."""
    settings: AdapterSettings = front_end_settings(
        values, AdapterSettings, SensedRobotSettings, warn)
    _check(settings)
    return settings


def load_adapter(path: Path) -> AdapterSettings:
    """Return the settings for the node ``adapter`` in a ROS parameter file."""
    return load_parsed(path, ['adapter'], parse_adapter)


def _check(settings: AdapterSettings) -> None:
    if not settings.formats:
        raise UsageError(f"parameter 'formats' is empty: list some of {', '.join(FORMATS)}")
    try:
        re.compile(settings.names)
    except re.error as error:
        raise UsageError(
            f"parameter 'names' is not a regular expression ({error}): correct it") from None
    topics = [used.topic for used in settings.object_formats()]
    for name, topic in zip(settings.formats, topics):
        if topics.count(topic) > 1:
            raise UsageError(
                f"parameter 'formats' has {name!r} and another format of <robot>/{topic}: give"
                ' only one of them')
    if len({*settings.ids().values()}) < len(settings.robots):
        raise UsageError("parameters '<robot>.id' are the same for two robots: give each its own")
    owners: dict[str, str] = {}
    for robot, robot_settings in settings.of_robots.items():
        for tag in robot_settings.tags:
            if owners.setdefault(tag, robot) != robot:
                raise UsageError(
                    f"parameters '{owners[tag]}.tags' and '{robot}.tags' both have {tag!r}: give"
                    ' each robot its own')
