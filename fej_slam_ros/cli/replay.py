# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Estimate from a bag without topics, as fast as the machine allows.

The same estimator as the node's: given the same input, the same numbers bit for bit.
"""

import argparse
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import Any

from tqdm import tqdm

from fej_slam_ros.cli.table import run_table
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros import bags, parameters
from fej_slam_ros.ros.diagnostics import Diagnostics
from fej_slam_ros.ros.outputs import Publication
from fej_slam_ros.ros.run import Run

OVERVIEW_PERIOD = 1_000_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder of a rosbag2')
    parser.add_argument(
        '--params', type=Path, required=True, metavar='FILE', help='ROS parameters (YAML)')
    parser.add_argument(
        '--output', type=Path, required=True, metavar='DIR', help='folder for the results')
    parser.add_argument(
        '--bag', dest='write_bag', action='store_true',
        help='also write the output topics as a rosbag2, DIR/bag')
    parser.add_argument(
        '--force', action='store_true', help='replace the results of an earlier run')


def run(arguments: argparse.Namespace) -> int:
    """Replay the bag and print what came of it."""
    settings = parameters.load(arguments.params)
    topics = bags.topics(arguments.bag)
    check_topics(arguments.bag, topics, settings)
    written: Path = arguments.output / 'bag'
    folders = _folders(arguments.output)
    if arguments.write_bag and written.resolve() == arguments.bag.resolve():
        raise UsageError(f'{written} is the bag to replay: choose another folder for the results')
    with ExitStack() as stack:
        replayed = Run(settings, next(folders), arguments.force)
        stack.callback(replayed.discard)
        sink = Sink()
        if arguments.write_bag:
            bag = bags.BagWriter(written, force=arguments.force)
            sink = BagSink(stack.enter_context(bag), replayed)
        total = sum(topic.messages for topic in topics.values())
        for message in tqdm(bags.read(arguments.bag), total=total, unit='msg', disable=None):
            replayed.receive(message)
            if replayed.is_over():
                sink.take(message.received or 0, replayed.close())
                print(run_table(replayed.keep()), end='\n\n')
                ended = replayed
                replayed = Run(ended.next_settings(output=''), next(folders), arguments.force)
                stack.callback(replayed.discard)
                replayed.follow(ended)
                sink.report_on(replayed)
            sink.take(message.received or 0, replayed.take())
        sink.end(replayed.close())
        told = replayed.keep()
    print(run_table(told))
    return 0


def _folders(first: Path) -> Iterator[Path]:
    """Yield where the files of each run go, of which there are several if time jumps back."""
    yield first
    for number in count(2):
        yield first.resolve().with_name(f'{first.resolve().name}_{number}')


def check_topics(bag: Path, topics: Iterable[str], settings: Settings) -> None:
    """Refuse a bag that has nothing for any robot."""
    wanted = [f'{robot.name}/odom' for robot in settings.robots]
    if not any(topic in topics for topic in wanted):
        raise UserError(
            f'{bag} has none of the topics {", ".join(wanted)}: it has'
            f' {", ".join(sorted(topics)) or "none"}; name its robots in the parameter robots')


class Sink:
    """Where publications go: nowhere."""

    def report_on(self, replayed: Run) -> None:
        """Let overviews be of a run from now on."""

    def take(self, now: int, publications: Iterable[Publication]) -> None:
        """Take publications because of a message of the time [ns]."""
        for _ in publications:
            pass

    def end(self, publications: Iterable[Publication]) -> None:
        """Take the last publications."""
        self.take(0, publications)


class BagSink(Sink):
    """Where publications go: into a bag, on the topics that the node has."""

    def __init__(self, bag: bags.BagWriter, replayed: Run) -> None:
        self._bag = bag
        self._now: int = 0
        self._next_overview: int | None = None
        self.report_on(replayed)

    def report_on(self, replayed: Run) -> None:
        """Let overviews be of a run from now on."""
        self._run = replayed
        self._diagnostics = Diagnostics(replayed.estimator, replayed.inputs)

    def take(self, now: int, publications: Iterable[Publication]) -> None:
        """Write publications, and now and then an overview."""
        self._now = max(now, self._now)
        self._write(publications)
        if self._next_overview is None or self._now >= self._next_overview:
            self._next_overview = self._now + OVERVIEW_PERIOD
            self._write_overview(at_rest=False)

    def end(self, publications: Iterable[Publication]) -> None:
        """Write the last publications and a last overview."""
        self._write(publications)
        self._write_overview(at_rest=True)

    def _write_overview(self, at_rest: bool) -> None:
        self._write(self._run.outputs.overview(lambda topic: True))
        self._write([self._diagnostics.report(self._now, at_rest)])

    def _write(self, publications: Iterable[Any]) -> None:
        for topic, message in publications:
            self._bag.write(topic.replace('~', 'estimator').lstrip('/'), self._now, message)
