# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Copy a bag and add the landmarks and robots that tags and other detected objects show.

They are those that the node adapter publishes, bit for bit.
"""

import argparse
from collections.abc import Mapping
from contextlib import closing
from functools import partial

from fej_slam_ros.cli.front_end_run import add_copy_arguments, write_copy
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.front_end_topics import formats_in
from fej_slam_ros.ros.files.ids_file import IdsFile
from fej_slam_ros.ros.messages.object_formats import FORMATS
from fej_slam_ros.ros.parameters.adapter_settings import (
    AdapterSettings, known_parameters, load_adapter)
from fej_slam_ros.ros.session.adapter_session import AdapterSession
from fej_slam_ros.ros.topic_types import STATIC_TF, TF_TYPE


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_copy_arguments(parser, known_parameters())


def run(arguments: argparse.Namespace) -> int:
    """Write the bag and print what was found and what was rejected."""
    settings = load_adapter(arguments.params)
    with closing(IdsFile(settings.ids_file)) as ids:
        session = AdapterSession(settings, ids.ids, ids.save)
        write_copy(arguments, session, partial(_unusable, session, settings))
    return 0


def _unusable(
    session: AdapterSession, settings: AdapterSettings, topics: Mapping[str, bags.BagTopic]
) -> str:
    """Return what a bag has without messages that can be read, and the cure."""
    if not any(topic in topics for topic in session.object_topics):
        return _missing(settings, topics)
    types = {used.type_name for used in settings.object_formats()}
    for name in session.object_topics:
        if name in topics and topics[name].type_name != session.topics[name]:
            return (
                f'{name} of the type {topics[name].type_name}, the parameter formats needs'
                f' {session.topics[name]}: choose other formats')
        if name in topics and topics[name].type_name in types and not topics[name].is_known:
            return (
                f'{topics[name].type_name} of another release than ROS 2 Jazzy, which cannot be'
                ' read: record it with the packages of Jazzy')
    return ''


def _missing(settings: AdapterSettings, topics: Mapping[str, bags.BagTopic]) -> str:
    """Return what a bag without topics of the formats lacks, and the cure."""
    formats = settings.object_formats()
    missing = sorted({
        used.topic if used.type_name == TF_TYPE else f'<robot>/{used.topic}' for used in formats})
    return f'no {" or ".join(missing)} of the robots in robots, {_cure(settings, topics)}'


def _cure(settings: AdapterSettings, topics: Mapping[str, bags.BagTopic]) -> str:
    types = {used.type_name for used in settings.object_formats()}
    found = [
        name for name, topic in topics.items()
        if topic.type_name in types and not name.endswith(STATIC_TF)]
    if found:
        return f'they are on {", ".join(found)}: correct robots, or use --remap'
    present = {name for robot in settings.robots for name in formats_in(topics, robot)}
    if present:
        return f'but messages of other formats: set formats: [{min(present)}]'
    namespaces = {name.rpartition('/')[0] for name in topics}
    others = sorted({
        f'{space}/{FORMATS[name].topic}'
        for space in namespaces for name in formats_in(topics, space)})
    if others:
        return (
            f'but messages of other formats on {", ".join(others)}: correct robots and formats, or'
            ' use --remap')
    if 'tf' in topics:
        return 'choose formats that it has, apriltag for tags on /tf'
    return 'nor messages of another format that could be read' + (
        ': record /tf, where apriltag_ros publishes the tags' if TF_TYPE in types else '')
