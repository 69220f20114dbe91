# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Common part of `replay` and `smooth`: a session over a bag, files and an output bag out."""

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import replace
import logging
from pathlib import Path
from typing import Any, Generic, TypeVar

from fej_slam_ros.atomic_files import refuse_existing, write_figure
from fej_slam_ros.cli.arguments import (
    add_bag_and_parameters, output_folder, refuse_input_as_output, require_matplotlib)
from fej_slam_ros.cli.bag_input import team_messages
from fej_slam_ros.cli.run_picture import draw_run, PICTURE
from fej_slam_ros.cli.topic_options import add_topic_names, names_in
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.sentences import reasons_in_words
from fej_slam_ros.errors import UserError
from fej_slam_ros.interrupts import postponed
from fej_slam_ros.ros.files import bags, run_results
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.parameters import changes_before, RunSettings
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.session.rejection_cures import description_and_cure
from fej_slam_ros.ros.session.session import Session
from fej_slam_ros.ros.session.topic_flow import SENT_AGAIN, TopicFlow
from fej_slam_ros.ros.topic_types import OBSERVATION_TOPICS

SessionT = TypeVar('SessionT', bound=Session)

#: Period of map, paths and diagnostics in the output bag [ns], as the node publishes them.
OVERVIEW_PERIOD = NS


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_bag_and_parameters(parser)
    parser.add_argument(
        '--output', type=output_folder, required=True, metavar='DIR',
        help='folder for the results')
    parser.add_argument(
        '--bag', dest='write_bag', action='store_true',
        help='also write the output topics as a rosbag2, DIR/bag, in the namespace of --namespace')
    parser.add_argument(
        '--picture', action='store_true',
        help='also draw map and trajectories, DIR/scene.png (needs matplotlib)')
    parser.add_argument('--force', action='store_true', help='replace earlier results')
    add_topic_names(parser)


class Sink(Generic[SessionT]):
    """Consumer of the publications of sessions that discards them."""

    def take(self, now: int, session: SessionT, publications: Iterable[Publication]) -> None:
        """Consume the publications caused by a message of the given log time [ns]."""
        self.write(publications)

    def close(self, session: SessionT) -> None:
        """Close a session and consume its last publications."""
        self.write(session.close())

    def end(self, session: SessionT) -> None:
        """Close the last session."""
        self.close(session)

    def write(self, publications: Iterable[Publication]) -> None:
        """Discard publications."""
        for _ in publications:
            pass


class BagSink(Sink[SessionT]):
    """Consumer of publications that writes them to a bag, on the topics of the node."""

    def __init__(self, bag: bags.BagWriter, node: str, names: TopicNames) -> None:
        self._bag = bag
        self._node = node
        self._names = names
        self.now = 0  #: log time of the newest message [ns]
        self._next_overview = 0

    def take(self, now: int, session: SessionT, publications: Iterable[Publication]) -> None:
        """Write publications, and an overview once a period."""
        self.now = max(now, self.now)
        self.write(publications)
        if self.now >= self._next_overview:
            self._next_overview = self.now + OVERVIEW_PERIOD
            self._write_overview(session, at_rest=False)

    def end(self, session: SessionT) -> None:
        """Write the last publications and a last overview."""
        super().end(session)
        self._write_overview(session, at_rest=True)

    def log_time(self, topic: str, message: Message) -> int:
        """Return the log time to write a message with [ns]."""
        return self.now

    def write(self, publications: Iterable[Publication]) -> None:
        """Write publications at their log times."""
        for topic, message in publications:
            name = self._names.published(topic.replace('~', self._node))
            self._bag.write(name, self.log_time(topic, message), message)

    def _write_overview(self, session: SessionT, at_rest: bool) -> None:
        self.write(session.outputs.maps_and_paths())
        self.write([session.diagnostics.report(self.now, at_rest)])


def process(
    arguments: argparse.Namespace, settings: RunSettings, node: str,
    begin: Callable[[RunSettings, Path, bool], SessionT],
    bag_sink: type[BagSink[SessionT]] = BagSink,
) -> list[tuple[SessionT, dict[str, Any]]]:
    """
    Run a session over a bag, and a new one after each time jump; return each with its summary.

    Each has a folder of its own for its files: DIR, DIR_2, DIR_3, ...

    Parameters
    ----------
    settings : of the first session
    node : name of the node that does the same live
    begin : creates a session from its settings, its folder, and whether files may be replaced
    bag_sink : writes the output bag

    """
    names = names_in(arguments, arguments.bag)
    messages = team_messages(arguments.bag, settings.estimation, names)
    output_bag = arguments.output / 'bag'
    _check(arguments, output_bag)
    runs: list[tuple[SessionT, dict[str, Any]]] = []
    folders: list[Path] = []
    stack = ExitStack()

    def start(settings: RunSettings) -> SessionT:
        with postponed():
            folders.append(_folder(arguments.output, len(folders) + 1))
            session = begin(settings, folders[-1], arguments.force)
            stack.callback(session.discard_files)
        refuse_existing([folders[-1] / PICTURE], arguments.force)
        session.diagnostics.node_name = names.published(node)
        session.source = {'bag': str(arguments.bag.resolve()), **names.as_dict()}
        return session

    with stack:
        session = start(settings)
        _warn_of_changes(session.settings)
        sink: Sink[SessionT] = Sink()
        if arguments.write_bag:
            with postponed():
                bag = stack.enter_context(bags.BagWriter(output_bag, force=arguments.force))
            sink = bag_sink(bag, node, names)
        for message in messages:
            session.receive(message)
            if session.inputs.time_jump_detector.has_ended_run():
                sink.close(session)
                runs.append((session, session.write_files()))
                ended, session = session, start(session.next_settings(output=''))
                session.continue_from(ended)
            sink.take(message.received or 0, session, session.take())
        sink.end(session)
        runs.append((session, session.write_files()))
    for folder in folders:
        _renew_picture(folder, arguments.picture)
        _warn_of_earlier(arguments, folder / 'evaluation', 'fej_slam evaluate')
    if not arguments.write_bag:
        _warn_of_earlier(arguments, output_bag, '--bag')
    return runs


def print_tables(
    arguments: argparse.Namespace, sessions: Sequence[Session], tables: Iterable[str]
) -> None:
    """
    Print the tables of sessions; warn before if nothing was observed.

    Raises
    ------
    UserError
        After the tables, if all odometry or all scans of the bag were rejected.

    """
    flows = _flows(sessions)
    _warn_of_odometry_only(arguments, flows)
    print('\n\n'.join(tables))
    _require_use(arguments, flows, sessions[0].settings)


def _warn_of_odometry_only(
    arguments: argparse.Namespace, flows: Iterable[tuple[str, TopicFlow]]
) -> None:
    scans = [flow for kind, flow in flows if kind in OBSERVATION_TOPICS]
    if not any(flow.observations or flow.rejected_in_a_row for flow in scans):
        logging.getLogger(__name__).warning(
            '%s has no observations of landmarks or robots, so all poses are those of odometry'
            ' alone: fej_slam doctor %s --params %s names the cause',
            arguments.bag, arguments.bag, arguments.params)


def _require_use(
    arguments: argparse.Namespace, flows: Sequence[tuple[str, TopicFlow]], settings: RunSettings
) -> None:
    for kinds in ('odom',), OBSERVATION_TOPICS:
        rejected = [flow.rejected_in_a_row for kind, flow in flows if kind in kinds]
        received = sum(flow.received for kind, flow in flows if kind in kinds)
        reasons = sum(rejected, Counter[RejectionReason]())
        # A run that is restored from a checkpoint may get what it has used before, or missed.
        may_be_old = SENT_AGAIN | ({RejectionReason.LATE} if settings.node.restore else set())
        if received == reasons.total() and not reasons.keys() <= may_be_old:
            topics, (reason, _) = [f'<robot>/{kind}' for kind in kinds], *reasons.most_common(1)
            _, cure = description_and_cure(topics[0], reason, settings.estimation)
            raise UserError(
                f'all {received} messages on {" and ".join(topics)} are rejected:'
                f' {reasons_in_words(reasons)}: {cure}; fej_slam doctor {arguments.bag} --params'
                f' {arguments.params} checks the bag')


def _flows(sessions: Iterable[Session]) -> list[tuple[str, TopicFlow]]:
    """Return the last part of each topic with messages, and these."""
    return [
        (kind, flow) for session in sessions for health in session.inputs.health.robots.values()
        for kind, flow in health.flows.items() if flow.received]


def _folder(output: Path, number: int) -> Path:
    """Return the folder of the first session, the second one, and so on."""
    if number == 1:
        return output
    path = output.resolve()
    return path.with_name(f'{path.name}_{number}')


def _warn_of_changes(settings: RunSettings) -> None:
    """Warn if the parameters of a restored run are not those that were given."""
    if changed := changes_before(settings):
        logging.getLogger(__name__).warning(
            'the run of the checkpoint began with changed parameters, which stay in force: %s',
            changed)


def _check(arguments: argparse.Namespace, output_bag: Path) -> None:
    """Raise an error if the picture cannot be drawn, or if the output bag is the input."""
    if arguments.picture:
        require_matplotlib('leave out --picture')
    if arguments.write_bag:
        refuse_input_as_output(output_bag, arguments.bag)


def _warn_of_earlier(arguments: argparse.Namespace, left: Path, renewed_by: str) -> None:
    """Warn of results that may be of an earlier run; a bag may be any, so nothing is deleted."""
    if arguments.force and left.exists() and left.resolve() != arguments.bag.resolve():
        logging.getLogger(__name__).warning(
            '%s is of an earlier run and stays as it is: %s renews it', left, renewed_by)


def _renew_picture(folder: Path, is_wanted: bool) -> None:
    """
    Delete the picture of an earlier run, and draw the estimates in ``map`` if it is wanted.

    Where no robot is in ``map``, those in the frame of the first one are drawn.
    """
    (folder / PICTURE).unlink(missing_ok=True)
    if not is_wanted:
        return
    result = run_results.read_folder(folder)
    frames = {name: trajectory.frame for name, trajectory in result.trajectories.items()}
    frame = MAP if MAP in frames.values() else next(iter(frames.values()), MAP)
    if frame != MAP:
        result = replace(result, landmarks=run_results.landmarks(folder, frame))
    write_figure(
        folder / PICTURE, draw_run,
        f'{folder.resolve().name}: estimates in {frame} with 3-sigma ellipses', result,
        [name for name in frames if frames[name] == frame], {}, [])
