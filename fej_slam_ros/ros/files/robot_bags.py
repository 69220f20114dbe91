# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Bags that the computers of several robots have recorded, each of its own robot."""

from collections.abc import Iterator, Mapping
from heapq import merge
from pathlib import Path

from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.bags import BagTopic
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import RawMessage


class RobotBags:
    """
    Bags as one, in which all topics of a bag are below the name of its robot.

    A topic that is below that name already keeps its name.

    Parameters
    ----------
    bag_of : bag of each robot, by name

    Attributes
    ----------
    topics : topics of all bags by their names in the team

    """

    def __init__(self, bag_of: Mapping[str, Path]) -> None:
        self._bag_of = bag_of
        self._names = {
            robot: TopicNames({'/': f'/{robot}/', f'/{robot}/': f'/{robot}/'}) for robot in bag_of}
        self.topics: dict[str, BagTopic] = {}
        for robot, bag in bag_of.items():
            self.topics |= _topics(bag, self._names[robot])

    def messages(self) -> Iterator[RawMessage]:
        """Yield the messages of all bags in the order of recording."""
        return merge(
            *(bags.read(bag, self._names[robot]) for robot, bag in self._bag_of.items()),
            key=lambda message: message.received or 0)


def _topics(bag: Path, names: TopicNames) -> dict[str, BagTopic]:
    """Return the topics of a bag by their names in the team; UserError if two become one."""
    recorded = bags.topics(bag)
    clash = names.clash(recorded)
    if clash is not None:
        one, other = clash
        raise UserError(
            f'{bag} has both /{one} and /{other}, which would both be /{names.name(other)}: leave'
            ' one of them out with rosbags-convert --exclude-topic')
    return {names.name(topic): of_topic for topic, of_topic in recorded.items()}
