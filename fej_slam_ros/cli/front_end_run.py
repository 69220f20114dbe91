# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Copies of bags with the landmarks that a front end adds."""

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from fej_slam_ros.cli.arguments import (
    add_bag_and_parameters, add_output_bag, parameter_help, refuse_input_as_output)
from fej_slam_ros.cli.topic_options import add_topic_names, names_in
from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.session.front_end import FrontEnd, RobotCounts
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.topic_types import OBSERVATION_TOPICS
from fej_slam_ros.tables import text_table


def add_copy_arguments(
    parser: argparse.ArgumentParser, parameters: Mapping[str, Parameter]
) -> None:
    """Add the bags and the parameters of a front end."""
    add_bag_and_parameters(parser)
    add_output_bag(parser, 'folder of the copy')
    add_topic_names(parser)
    parser.epilog = parameter_help(parameters)


def write_copy(
    arguments: argparse.Namespace, front_end: FrontEnd,
    unusable: Callable[[Mapping[str, bags.BagTopic]], str],
) -> None:
    """
    Write the bag and print what was found and what was rejected.

    `unusable` returns what the topics have instead of input of the front end, '' if they have it.

    """
    names = names_in(arguments, arguments.bag)
    topics = bags.topics(arguments.bag, names)
    refuse_input_as_output(arguments.output, arguments.bag)
    _refuse_outputs(arguments.bag, front_end, topics)
    if found := unusable(topics):
        raise UserError(f'{arguments.bag} has {found}')
    with bags.BagWriter(arguments.output, arguments.storage, arguments.force) as bag:
        scans = _copy(bags.read_with_bar(arguments.bag, names, topics), topics, front_end, bag)
        print('\n'.join(_report([*front_end.counts()])))
        if not scans:
            raise UserError(
                f'no message of {arguments.bag} could be used, so nothing is written: correct what'
                ' the lines above name')
    if unknown := bags.unknown_types(topics.values()):
        print(unknown)
    print(f'wrote {arguments.output}')


def _copy(
    messages: Iterable[RawMessage], topics: Mapping[str, bags.BagTopic], front_end: FrontEnd,
    bag: bags.BagWriter,
) -> int:
    """Write messages, and what a front end makes of them; return its number of scans."""
    now = scans = 0
    for message in messages:
        now = max(now, message.received or 0)
        if topics[message.topic].is_known:
            bag.copy(message, topics[message.topic].latched)
        front_end.receive(message)
        scans += _write(bag, now, front_end.take())
    return scans + _write(bag, now, front_end.close())


def _report(counts: Sequence[RobotCounts]) -> Iterator[str]:
    """Yield the counts that are not zero for all robots, one in a column, and the warnings."""
    names = dict.fromkeys(name for _, _, values in counts for name in values)
    rows = {name: [values.get(name, 0) for _, _, values in counts] for name in names}
    yield text_table(
        ('', *(robot for robot, _, _ in counts)),
        [(name, *map(str, row)) for name, row in rows.items() if any(row)])
    yield from (f'{robot}: {warning}' for robot, warnings, _ in counts for warning in warnings)


def _refuse_outputs(
    bag: Path, front_end: FrontEnd, topics: Mapping[str, bags.BagTopic]
) -> None:
    """Raise UserError if a bag has landmarks already."""
    present = [topic for topic in front_end.outputs if topic in topics and '/' in topic[1:]]
    if present:
        raise UserError(
            f'{bag} has {", ".join(present)} already: give a bag without landmarks, or'
            ' rename these topics with --remap')


def _write(bag: bags.BagWriter, now: int, publications: Iterable[Publication]) -> int:
    """Write publications and return the number of scans of landmarks or robots."""
    scans = 0
    for topic, message in publications:
        bag.write(topic, now, message)
        scans += topic.endswith(OBSERVATION_TOPICS)
    return scans
