# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Copy a bag and add the landmarks and robots that tags and other detected objects show.

They are those that the node adapter publishes, bit for bit.
"""

import argparse

from fej_slam_ros.cli.front_end_run import add_copy_arguments, check_output, write_copy
from fej_slam_ros.cli.topic_options import names_in
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.landmark_ids import stored_ids
from fej_slam_ros.ros.parameters.adapter_settings import known_parameters, load_adapter
from fej_slam_ros.ros.session.adapter_session import AdapterSession


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_copy_arguments(parser, known_parameters())


def run(arguments: argparse.Namespace) -> int:
    """Write the bag and print what was found and what was rejected."""
    settings = load_adapter(arguments.params)
    session = AdapterSession(settings, *stored_ids(settings.ids_file))
    names = names_in(arguments, arguments.bag)
    topics = bags.topics(arguments.bag, names)
    check_output(arguments, session, topics)
    formats = settings.object_formats()
    if not any(topic in topics for topic in session.object_topics):
        types = {of.type_name for of in formats}
        found = [name for name, topic in topics.items() if topic.type_name in types]
        cure = f'they are on {", ".join(found)}: rename them with --remap' if found else (
            'choose formats that it has')
        raise UserError(
            f'{arguments.bag} has no {" or ".join(sorted({of.topic for of in formats}))} of the'
            f' robots in robots, {cure}')
    bags.check_definitions(arguments.bag, {of.type_name for of in formats})
    write_copy(arguments, session, topics, names)
    return 0
