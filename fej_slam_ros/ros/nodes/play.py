# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publish the messages of a bag on their topics."""

from collections.abc import Mapping
import math
from pathlib import Path

from rclpy.node import Node
from tqdm import tqdm

from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.nodes.endpoints import debian_package, is_installed
from fej_slam_ros.ros.nodes.player import Player
from fej_slam_ros.ros.nodes.ros_process import ros

#: Topic of simulated time, which two publishers would set back and forth.
CLOCK_TOPIC = 'clock'


def main(bag: Path, names: TopicNames, rate: float, clock: bool, wait: bool) -> int:
    """Play a bag under other names until its end or an interrupt; return 0."""
    if not 0.0 < rate < math.inf:
        raise UsageError(f'--rate {rate}: give a number above 0')
    topics = bags.topics(bag, names)
    if not topics:
        raise UserError(f'{bag} has no topics: give another bag')
    with ros([]) as stopped:
        node = Node('play')
        played = {
            name: topic for name, topic in topics.items() if is_installed(topic.type_name)}
        if played.keys() < topics.keys():
            node.get_logger().warning(
                _left_out({name: topics[name] for name in topics if name not in played}))
        if clock and CLOCK_TOPIC in played:
            node.get_logger().info(
                '/clock is in the bag: it is played, and --clock has no effect')
            clock = False
        latched = [name for name, topic in played.items() if topic.latched]
        player = Player(
            node, {name: topic.type_name for name, topic in played.items()}, latched, rate, clock)
        messages = tqdm(
            (message for message in bags.read(bag, names) if message.topic in played),
            total=sum(topic.messages for topic in played.values()), unit='msg', disable=None)
        player.run(messages, wait, stopped)
    return 0


def _left_out(topics: Mapping[str, bags.BagTopic]) -> str:
    """Return which topics are not played, and which packages they need."""
    names = ', '.join(f'{name} ({topic.messages} messages)' for name, topic in topics.items())
    packages = sorted({debian_package(topic.type_name) for topic in topics.values()})
    return f'left out: {names}; to play them, apt install {" ".join(packages)}'
