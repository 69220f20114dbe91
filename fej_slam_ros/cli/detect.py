# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Copy a bag and add the landmarks in its laser scans.

The landmarks are those that the node detector publishes, bit for bit, as long as odometry comes
within a second of its scans.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

from tqdm import tqdm

from fej_slam_ros.cli.arguments import add_bag_and_parameters, add_storage, parameter_help
from fej_slam_ros.cli.topic_options import add_topic_names, names_in
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import is_known, RawMessage
from fej_slam_ros.ros.parameters.detector_settings import DETECTOR_PARAMETERS, load_detector
from fej_slam_ros.ros.session.detector_session import DetectorSession, LASER_SCAN
from fej_slam_ros.ros.session.outputs import Publication


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_and_parameters(parser)
    parser.add_argument(
        '--output', type=Path, required=True, metavar='BAG', help='folder of the copy')
    add_storage(parser)
    parser.add_argument('--force', action='store_true', help='replace an existing bag')
    add_topic_names(parser)
    parser.epilog = parameter_help(DETECTOR_PARAMETERS)


def run(arguments: argparse.Namespace) -> int:
    """Write the bag and print what was found and what was rejected."""
    settings = load_detector(arguments.params)
    names = names_in(arguments, arguments.bag)
    topics = bags.topics(arguments.bag, names)
    session = DetectorSession(settings)
    _check(arguments, session, topics)
    total = sum(topic.messages for topic in topics.values())
    with bags.BagWriter(arguments.output, arguments.storage, arguments.force) as bag:
        now = 0
        messages: Iterable[RawMessage] = tqdm(
            bags.read(arguments.bag, names), total=total, unit='msg', disable=None)
        for message in messages:
            now = max(now, message.received or 0)
            if is_known(message.type_name):
                bag.copy(message, topics[message.topic].latched)
            session.receive(message)
            _write(bag, now, session.take())
        _write(bag, now, session.close())
    for robot, warning, values in session.counts():
        counts = ', '.join(f'{name}: {n}' for name, n in values.items())
        print(f'{robot}: {counts}' + (f'\n    {warning}' if warning else ''))
    unknown = sorted({of.type_name for of in topics.values() if not is_known(of.type_name)})
    if unknown:
        print(f'not copied, of unknown types: {", ".join(unknown)}')
    print(f'wrote {arguments.output}')
    return 0


def _write(bag: bags.BagWriter, now: int, publications: Iterable[Publication]) -> None:
    for topic, message in publications:
        bag.write(topic, now, message)


def _check(
    arguments: argparse.Namespace, session: DetectorSession, topics: dict[str, bags.BagTopic]
) -> None:
    if arguments.output.resolve() == arguments.bag.resolve():
        raise UsageError(f'{arguments.output} is the bag to read: choose another output')
    present = [topic for topic in session.outputs if topic in topics and '/' in topic[1:]]
    if present:
        raise UserError(
            f'{arguments.bag} has {", ".join(present)} already: detect in a bag without landmarks,'
            ' or rename these topics with --remap')
    if not any(f'{name}/scan' in topics for name in session.robots):
        scans = [name for name, topic in topics.items() if topic.type_name == LASER_SCAN]
        found = f'its scans are on {", ".join(scans)}: rename them with --remap' if scans else (
            'it has no laser scans')
        raise UserError(f'{arguments.bag} has no <robot>/scan of the robots in robots, {found}')
