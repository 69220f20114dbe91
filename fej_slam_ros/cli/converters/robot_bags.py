# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Merge bags that the computers of several robots have recorded, each of its own robot.

All topics of a bag get the name of its robot in front, if they do not have it: /odom and /r1/odom
of r1=BAG are both /r1/odom. Other commands read these names with --remap. Frames keep their names.
Messages are in the order of recording and keep their stamps: if robots observe each other, the
clocks of their computers must agree.
"""

from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.cli.arguments import refuse_input_as_output
from fej_slam_ros.cli.converters.common import add_output, write_with_parameters
from fej_slam_ros.core.settings import numbered_robots, Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.files.robot_bags import RobotBags

SUMMARY = 'a bag of each robot, recorded on its own computer'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        '--input', nargs='+', metavar='ROBOT=BAG', type=_robot_and_bag, required=True,
        help='the name of each robot, and the folder of its bag')
    add_output(parser)


def _robot_and_bag(word: str) -> tuple[str, Path]:
    robot, _, bag = word.partition('=')
    if not robot or not bag:
        raise UsageError(f'--input {word}: give ROBOT=BAG, such as r1=recorded_by_r1')
    return robot, Path(bag)


def convert(arguments: Namespace) -> None:
    """Write the bag of the team and print the number of messages of each robot."""
    names = parameters.robot_names([robot for robot, _ in arguments.input])
    for _, bag in arguments.input:
        refuse_input_as_output(arguments.output, bag)
    robots = RobotBags(dict(arguments.input))
    copied: Counter[str] = Counter()
    settings = Settings(numbered_robots(names), anchor=names[0])
    write_with_parameters(
        lambda: _copy(robots, arguments, copied), settings, arguments,
        _report(names, robots, copied))


def _copy(robots: RobotBags, arguments: Namespace, copied: Counter[str]) -> None:
    """Copy all messages of known types, and count them by topic."""
    total = sum(topic.messages for topic in robots.topics.values())
    with bags.BagWriter(arguments.output, arguments.storage, arguments.force) as bag:
        for message in tqdm(robots.messages(), total=total, unit='msg', disable=None):
            topic = robots.topics[message.topic]
            if topic.is_known:
                bag.copy(message, topic.latched)
                copied[message.topic] += 1


def _report(
    names: tuple[str, ...], robots: RobotBags, copied: Counter[str]
) -> Iterator[str]:
    for name in names:
        own = {topic: count for topic, count in copied.items() if topic.startswith(f'{name}/')}
        yield f'{name}: topics: {len(own)}, messages: {sum(own.values())}'
    unknown = bags.unknown_types(robots.topics.values())
    if unknown:
        yield unknown
