# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What `replay` and `smooth` have in common: a bag in, files out."""

import argparse
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from fej_slam_ros.cli.arguments import add_bag_and_parameters
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import CommonSettings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.files import bags
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.session.session import Session

RunT = TypeVar('RunT', bound=Session)

OVERVIEW_PERIOD = NS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    add_bag_and_parameters(parser)
    parser.add_argument(
        '--output', type=Path, required=True, metavar='DIR', help='folder for the results')
    parser.add_argument(
        '--bag', dest='write_bag', action='store_true',
        help='also write the output topics as a rosbag2, DIR/bag')
    parser.add_argument(
        '--force', action='store_true', help='replace the results of an earlier run')


class Sink:
    """Where publications go: nowhere."""

    def report_on(self, made: Session) -> None:
        """Let overviews be of a run from now on."""

    def take(self, now: int, publications: Iterable[Publication]) -> None:
        """Take publications because of a message of the time [ns]."""
        for _ in publications:
            pass

    def end(self, publications: Iterable[Publication]) -> None:
        """Take the last publications."""
        self.take(0, publications)


class BagSink(Sink):
    """
    Where publications go: into a bag, on the topics that the node has.

    Attributes
    ----------
    now : time of the newest message [ns]

    """

    def __init__(self, bag: bags.BagWriter, node: str, made: Session) -> None:
        self._bag = bag
        self._node = node
        self.now: int = 0
        self._next_overview: int | None = None
        self.report_on(made)

    def report_on(self, made: Session) -> None:
        """Let overviews be of a run from now on."""
        self._run = made

    def take(self, now: int, publications: Iterable[Publication]) -> None:
        """Write publications, and now and then an overview."""
        self.now = max(now, self.now)
        self._write(publications)
        if self._next_overview is None or self.now >= self._next_overview:
            self._next_overview = self.now + OVERVIEW_PERIOD
            self._write_overview(at_rest=False)

    def end(self, publications: Iterable[Publication]) -> None:
        """Write the last publications and a last overview."""
        self._write(publications)
        self._write_overview(at_rest=True)

    def _write_overview(self, at_rest: bool) -> None:
        self._write(self._run.outputs.maps_and_paths(lambda topic: True))
        self._write([self._run.diagnostics.report(self.now, at_rest)])

    def logged_at(self, topic: str, message: Message) -> int:
        """Return when a message is said to have been recorded [ns]."""
        return self.now

    def _write(self, publications: Iterable[Publication]) -> None:
        for topic, message in publications:
            name = topic.replace('~', self._node).lstrip('/')
            self._bag.write(name, self.logged_at(topic, message), message)


def process(
    arguments: argparse.Namespace, settings: RunSettings, node: str,
    begin: Callable[[RunSettings, Path, bool], RunT], bag_sink: type[BagSink] = BagSink,
) -> Iterator[tuple[RunT, dict[str, Any]]]:
    """
    Give a bag to a run, or to several where time jumps back; yield each and its summary.

    Parameters
    ----------
    arguments : of the command line
    settings : under which it is to run
    node : whose topics the run has
    begin : begins a run from settings, its folder, and whether files may be replaced
    bag_sink : what writes the output topics, where that is wanted

    """
    topics = bags.topics(arguments.bag)
    check_topics(arguments.bag, topics, settings.estimation)
    written: Path = arguments.output / 'bag'
    folders = _folders(arguments.output)
    if arguments.write_bag and written.resolve() == arguments.bag.resolve():
        raise UsageError(f'{written} is the bag to read: choose another folder for the results')
    with ExitStack() as stack:
        made = begin(settings, next(folders), arguments.force)
        made.source = source = {'bag': str(arguments.bag.resolve())}
        stack.callback(made.discard_files)
        sink = Sink()
        if arguments.write_bag:
            bag = bags.BagWriter(written, force=arguments.force)
            sink = bag_sink(stack.enter_context(bag), node, made)
        total = sum(topic.messages for topic in topics.values())
        for message in tqdm(bags.read(arguments.bag), total=total, unit='msg', disable=None):
            made.receive(message)
            if made.must_restart():
                sink.take(message.received or 0, made.close())
                yield made, made.write_files()
                ended = made
                made = begin(ended.next_settings(output=''), next(folders), arguments.force)
                made.source = source
                stack.callback(made.discard_files)
                made.continue_from(ended)
                sink.report_on(made)
            sink.take(message.received or 0, made.take())
        sink.end(made.close())
        told = made.write_files()
    yield made, told


def _folders(first: Path) -> Iterator[Path]:
    """Yield where the files of each run go, of which there are several if time jumps back."""
    yield first
    for number in count(2):
        yield first.resolve().with_name(f'{first.resolve().name}_{number}')


def check_topics(bag: Path, topics: Iterable[str], settings: CommonSettings) -> None:
    """Refuse a bag that has nothing for any robot."""
    wanted = [f'{robot.name}/odom' for robot in settings.robots]
    if not any(topic in topics for topic in wanted):
        raise UserError(
            f'{bag} has none of the topics {", ".join(wanted)}: it has'
            f' {", ".join(sorted(topics)) or "none"}; name its robots in the parameter robots')
