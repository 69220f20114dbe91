# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag from which a front end can compute observations of landmarks."""

from collections.abc import Iterable, Mapping

from fej_slam_ros.ros.files.bags import BagTopic
from fej_slam_ros.ros.messages.object_formats import FORMATS
from fej_slam_ros.ros.topic_types import LASER_SCAN, TF_TYPE


def formats_in(topics: Mapping[str, BagTopic], robot: str) -> list[str]:
    """Return the formats of objects that a robot has in a bag, by the names of its topics."""
    return [
        name for name, object_format in FORMATS.items()
        if object_format.type_name != TF_TYPE
        and (topic := topics.get(f'{robot}/{object_format.topic}')) is not None
        and topic.messages and topic.type_name == object_format.type_name]


def inputs(topics: Mapping[str, BagTopic], robots: Iterable[str]) -> list[str]:
    """Return the topics of robots in a bag that a front end reads."""
    return [
        name for name, topic in topics.items() for robot in robots
        if (name == f'{robot}/scan' and topic.type_name == LASER_SCAN)
        or name in {f'{robot}/{FORMATS[used].topic}' for used in formats_in(topics, robot)}]


def cure(topics: Mapping[str, BagTopic], robot: str) -> str:
    """Return how observations of a robot are computed from a bag, '' if they cannot be."""
    scans = [
        name for name, topic in topics.items() if topic.messages and topic.type_name == LASER_SCAN]
    of_no_robot = [name for name in scans if f'{name.rpartition("/")[0]}/odom' not in topics]
    formats = formats_in(topics, robot)
    detect = 'fej_slam detect BAG --params FILE --output LANDMARKS'
    if f'{robot}/scan' in scans:
        return f'find posts or reflectors in {robot}/scan: {detect}'
    if formats:
        return (
            f'use {robot}/{FORMATS[formats[0]].topic} (formats: [{formats[0]}]): fej_slam adapt'
            ' BAG --params FILE --output LANDMARKS')
    if len(of_no_robot) == 1:
        return (
            f'find posts or reflectors in {of_no_robot[0]}: {detect} --remap'
            f' /{of_no_robot[0]}:=/{robot}/scan, beside the --remap of its odometry')
    return ''
