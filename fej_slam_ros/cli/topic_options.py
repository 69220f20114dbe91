# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The options --remap and --namespace of the verbs that read a bag."""

import argparse
from collections.abc import Mapping
from pathlib import Path

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.files.topic_names import (
    absolute_namespace, checked_rule, EXAMPLE, topic_names, TopicNames)
from fej_slam_ros.ros.topic_types import ROBOT_TOPICS


def add_topic_names(parser: argparse.ArgumentParser) -> None:
    """Add the options for bags with other topic names."""
    group = parser.add_argument_group('names of recorded topics')
    group.add_argument(
        '--remap', nargs='+', action='extend', type=checked_rule, default=[], metavar='OLD:=NEW',
        help='read the recorded topic OLD as NEW, as `ros2 bag play --remap` does, such as'
        f' {EXAMPLE}; names that end in a slash are of all topics below, such as /husky1/:=/r1/;'
        ' may be repeated; frames keep their names')
    group.add_argument(
        '--namespace', type=absolute_namespace, default='', metavar='NAMESPACE',
        help='work as a node in this namespace: with /fleet, /fleet/r1/odom is read as r1/odom')


def node_names(arguments: argparse.Namespace, *nodes: str) -> list[str]:
    """Return the nodes whose sections of a parameter file apply, also those in the namespace."""
    space = arguments.namespace.lstrip('/')
    return [*nodes, *(f'{space}/{node}' for node in nodes if space)]


def names_in(arguments: argparse.Namespace, *bags: Path, is_played: bool = False) -> TopicNames:
    """Return the names in the options for some bags; UsageError if their topics do not fit."""
    from fej_slam_ros.ros.files.bags import topics

    names = topic_names(arguments.remap, arguments.namespace)
    if not names:
        return names
    if not bags:
        raise UsageError('--remap, --namespace: no bag is read, leave the options out')
    recorded = {name: info.type_name for bag in bags for name, info in topics(bag).items()}
    names.check(recorded, ' and '.join(map(str, bags)), is_played)
    if not is_played:
        _check_types(names, recorded)
    return names


def _check_types(names: TopicNames, types: Mapping[str, str]) -> None:
    for old, new in names.renamed.items():
        expected = ROBOT_TOPICS.get(new.rpartition('/')[2])
        recorded = types.get(old.lstrip('/'))
        if None not in {expected, recorded} and recorded != expected:
            raise UsageError(
                f'--remap {old}:={new}: the type of {old} is {recorded}: rename a topic of type'
                f' {expected}')
