# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Publish the messages of a bag on their topics."""

import math
from pathlib import Path

from rclpy.node import Node
from tqdm import tqdm

from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.nodes.player import Player
from fej_slam_ros.ros.nodes.ros_process import ros


def main(bag: Path, names: TopicNames, rate: float, clock: bool, wait: bool) -> int:
    """Play a bag under other names until its end or an interrupt; return 0."""
    if not 0.0 < rate < math.inf:
        raise UsageError(f'--rate {rate}: give a number above 0')
    topics = bags.topics(bag, names)
    total = sum(topic.messages for topic in topics.values())
    with ros([]) as stopped:
        types = {name: topic.type_name for name, topic in topics.items()}
        latched = [name for name, topic in topics.items() if topic.latched]
        player = Player(Node('play'), types, latched, rate, clock)
        messages = tqdm(bags.read(bag, names), total=total, unit='msg', disable=None)
        return player.run(messages, wait, stopped)
