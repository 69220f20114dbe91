# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Export a bag as a graph file of g2o, or as CSV tables.

A graph has the measurements as `smooth` uses them, with its solution as the estimates. Parameters
beside the output are those to run the exported data with: what was applied to them is left out.
"""

from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from fej_slam_ros.atomic_files import csv_bytes, write_all
from fej_slam_ros.cli.arguments import add_bag_and_parameters, refuse_input_as_output
from fej_slam_ros.cli.bag_input import matches_in, team_messages
from fej_slam_ros.cli.topic_options import add_topic_names, names_in, node_names
from fej_slam_ros.core.ordering.impossible_motion import UNLIMITED
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.records import Odometry, Record, RobotScan, Scan, TrueLandmarks
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.datasets import csv_tables
from fej_slam_ros.datasets.g2o import conversion, files
from fej_slam_ros.datasets.g2o.graph import Graph, graph_of
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.interrupts import postponed
from fej_slam_ros.output_lock import claimed
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files.topic_names import TopicNames
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.session.record_collector import collect
from fej_slam_ros.ros.session.smoother_session import BagSmootherSession

NO_ODOMETRY = 'the bag has no valid odometry: replay it to see the rejection reasons'
#: Parameters, of the team or of a robot, that the exported measurements contain.
IN_TABLES = ('sensor_pose', 'sensor_delay')
IN_GRAPH = (
    *IN_TABLES, 'use_odometry_covariance', 'odometry_sigma', 'landmark_sigma', 'odometry_scale',
    'odometry_turn_bias', 'observation_range_scale', 'observation_bearing_bias',
    'observation_noise_growth', 'odometry_noise_scale', 'landmark_noise_scale',
    'robot_noise_scale', 'max_speed', 'max_turn_rate')


class Exported(NamedTuple):
    """An export that is not written yet."""

    report: list[str]  #: lines with the numbers of records
    parameters: Mapping[str, object]  #: those of a run on it, beside the given ones
    contents: Mapping[Path, bytes]  #: of its files
    obsolete: Sequence[Path] = ()  #: files of an earlier export that this one does not have


def add_arguments(parser: ArgumentParser) -> None:
    formats = parser.add_subparsers(metavar='FORMAT', required=True)
    for name, metavar, export, applied in (
        ('g2o', 'FILE', _export_graph, IN_GRAPH), ('csv', 'DIR', _export_tables, IN_TABLES),
    ):
        summary = (export.__doc__ or '').rstrip('.')
        of_format = formats.add_parser(
            name, allow_abbrev=False, help=summary, description=summary)
        add_bag_and_parameters(of_format)
        of_format.add_argument(
            '--output', type=Path, required=True, metavar=metavar,
            help=f'the export; {metavar}.yaml gets the parameters')
        of_format.add_argument('--force', action='store_true', help='replace an earlier export')
        add_topic_names(of_format)
        of_format.set_defaults(export=export, applied=applied)


def run(arguments: Namespace) -> int:
    """Export the bag and print the numbers of records."""
    nodes = node_names(arguments, 'estimator', 'smoother')
    settings = parameters.load(arguments.params, nodes)
    values = parameters.load_current_values(arguments.params, nodes)
    output, beside = arguments.output, Path(f'{arguments.output}.yaml')
    refuse_input_as_output(output, arguments.bag)
    if beside.resolve() == arguments.params.resolve():
        raise UsageError(f'{beside} is the parameter file to read: choose another output')
    with claimed(output, arguments.force), claimed(beside, arguments.force):
        exported = arguments.export(
            arguments.bag, settings, names_in(arguments, arguments.bag), output)
        kept = {
            name: x for name, x in values.items()
            if name.rpartition('.')[2] not in arguments.applied}
        text = parameters.dump_values(kept | exported.parameters)
        with postponed():
            write_all({**exported.contents, beside: text.encode()})
            for path in exported.obsolete:
                path.unlink(missing_ok=True)
    print('\n'.join([*exported.report, f'wrote {output} and {beside}']))
    return 0


def _export_graph(bag: Path, settings: RunSettings, names: TopicNames, path: Path) -> Exported:
    """Write poses and landmarks as `smooth` estimates them, and all measurements."""
    node = replace(settings.node, on_time_jump='refuse', restore='')
    session = BagSmootherSession(
        replace(settings, node=node), None, matches=matches_in(bag, settings, names))
    for message in team_messages(bag, settings.estimation, names):
        session.receive(message)
        for _ in session.take():
            pass
    for _ in session.close():
        pass
    team = session.team
    task = team.task()
    graph = graph_of(task, team.solution, {
        name: trajectory.stamps for name, trajectory in team.trajectories.items()})
    if not graph.names:
        raise UserError(NO_ODOMETRY)
    text = ''.join(f'{line}\n' for line in files.written(graph))
    between_maps = len(task.measurements) - len(graph.robot_observations)
    robots = [*conversion.by_robot(graph.names)]
    return Exported(
        [*_graph_report(graph, between_maps),
         *_rejected(team.statistics, but=[RejectionReason.GATED])],
        _ids(settings, robots) | {f'{name}.max_speed': UNLIMITED for name in robots},
        {path: text.encode()})


def _export_tables(
    bag: Path, settings: RunSettings, names: TopicNames, folder: Path
) -> Exported:
    """Write odometry, observations, pose priors and ground truth as tables."""
    messages = team_messages(bag, settings.estimation, names)
    collector = collect(messages, settings, needs_ids=False)
    early: Counter[str] = Counter()
    left_out: Counter[str] = Counter()
    since = [*_since_time_0((record for record, _ in collector.records), early)]
    records = [*_with_odometry(since, left_out)]
    if not any(isinstance(record, Odometry) for record in records):
        raise UserError(NO_ODOMETRY)
    tables = csv_tables.tables(records)
    report = [
        *(f'{name}: {len(rows) - 1} rows' for name, rows in tables.items()),
        *_rejected(collector.statistics),
        *(f'{robot}: scans before time 0, not exported: {n}' for robot, n in early.items()),
        *(f'{robot}: without odometry, not exported: {n}' for robot, n in left_out.items())]
    return Exported(
        report, _ids(settings, [robot.name for robot in csv_tables.settings(records).robots]),
        {folder / name: csv_bytes(rows) for name, rows in tables.items()},
        [folder / name for name in csv_tables.COLUMNS if name not in tables])


def _with_odometry(
    records: Sequence[Record], left_out: Counter[str]
) -> Iterator[Record]:
    """Yield records without those by and observations of robots that have none; count these."""
    robots = {record.robot for record in records if isinstance(record, Odometry)}
    for record in records:
        if isinstance(record, TrueLandmarks):
            yield record
        elif record.robot not in robots:
            left_out[record.robot] += 1
        elif isinstance(record, RobotScan):
            left_out.update(s.observed for s in record.observations if s.observed not in robots)
            yield replace(record, observations=tuple(
                s for s in record.observations if s.observed in robots))
        else:
            yield record


def _since_time_0(records: Iterable[Record], early: Counter[str]) -> Iterator[Record]:
    """Yield records without scans that are, by sensor_delay, from before time 0; count these."""
    for record in records:
        if isinstance(record, Scan | RobotScan) and record.stamp < 0:
            early[record.robot] += 1
        else:
            yield record


def _graph_report(graph: Graph, between_maps: int) -> Iterator[str]:
    poses = Counter(name.robot for name in graph.names.values())
    observations = Counter(graph.names[edge.begin].robot for edge in graph.observations)
    for robot, number in poses.items():
        yield f'{robot}: poses: {number}, observations: {observations[robot]}'
    yield f'landmarks: {len(graph.points)}'
    if graph.robot_observations:
        yield f'robot-to-robot observations: {len(graph.robot_observations)}'
    if between_maps:
        yield (
            'robot-to-robot observations between maps that are not joined, not exported:'
            f' {between_maps}')
    yield f'chi-square of all edges at the estimates: {graph.chi_square():.6g}'


def _rejected(
    statistics: InputStatistics, but: Collection[RejectionReason] = ()
) -> Iterator[str]:
    """Yield the numbers of rejections of each robot, which are not exported."""
    for robot, counts in statistics.rejection_counts.items():
        for reason, count in counts.items():
            if count and reason not in but:
                yield f'{robot}: rejected as {reason.value}: {count}'


def _ids(settings: RunSettings, exported: Sequence[str]) -> dict[str, object]:
    """Return the IDs by which `convert` writes observations of robots, as parameters."""
    without_data = (
        robot.name for robot in settings.estimation.robots if robot.name not in exported)
    names = [*exported, *without_data]
    return {f'{name}.id': number for number, name in enumerate(names, start=1)}
