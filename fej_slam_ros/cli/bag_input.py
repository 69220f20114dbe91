# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag for the robots of a team, which it is checked to have."""

from collections.abc import Iterable, Mapping
import logging
from pathlib import Path

from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags, front_end_topics
from fej_slam_ros.ros.files.recorded_robots import RecordedRobots, robots_in
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.topic_types import expected_topics


def team_messages(bag: Path, settings: CommonSettings, names: TopicNames) -> Iterable[RawMessage]:
    """
    Return the messages of a bag, read under other names, with a progress bar.

    A UserError says that it has odometry of no robot of the settings, or only of another type.

    """
    team = [robot.name for robot in settings.robots]
    topics = bags.topics(bag, names)
    names.check_new([*expected_topics(team), *front_end_topics.inputs(topics, team)])
    types = {name: topic.type_name for name, topic in topics.items() if topic.messages}
    absent = [f'{robot}/odom' for robot in team if f'{robot}/odom' not in types]
    if absent:
        recorded = RecordedRobots(bag, names, team)
        found = f'it has {recorded.found()}: {recorded.cure()}'
        others = ', '.join(name for name in robots_in(topics) if name not in team)
        if len(absent) == len(team):
            raise UserError(
                f'{bag} has messages on none of the topics {", ".join(absent)}, {found}'
                + (f', or name its robots ({others}) in the parameter robots' if others else ''))
        logging.getLogger(__name__).warning('%s has no %s, %s', bag, ', '.join(absent), found)
    _check_types(bag, team, types)
    for robot in team:
        computed = front_end_topics.cure(topics, robot)
        if computed and f'{robot}/landmarks' not in topics:
            logging.getLogger(__name__).warning(
                '%s has no %s/landmarks: %s', bag, robot, computed)
    return bags.read_with_bar(bag, names, topics)


def _check_types(bag: Path, team: Iterable[str], types: Mapping[str, str]) -> None:
    """Name the input topics of a team with messages of another type; some odometry is needed."""
    faults = {
        name: f'{bag} has {name} of the type {types[name]}, which is not used: record'
        f' {expected} on it, or give the topic that has it with --remap'
        for name, expected in expected_topics(team).items()
        if types.get(name, expected) != expected}
    odometry = [f'{robot}/odom' for robot in team if f'{robot}/odom' in types]
    if faults.keys() >= {*odometry}:
        raise UserError(faults[odometry[0]])
    for fault in faults.values():
        logging.getLogger(__name__).warning(fault)
