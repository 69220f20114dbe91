# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Convert a 2D graph of poses and landmarks, as of g2o, TORO, iSAM and GTSAM.

Lines: EDGE_SE2, EDGE2 and ODOMETRY between the poses, EDGE_SE2_XY, LANDMARK and BR to landmarks,
VERTEX_SE2, VERTEX2, VERTEX_XY and FIX. Each chain of poses with increasing numbers is a robot; a
file of `export g2o` names robots, stamps and IDs. Noise is that of the edges, in the frame at the
end of a relative pose, as g2o and GTSAM take it.
"""

from argparse import ArgumentParser, Namespace
from collections import Counter
from collections.abc import Iterable, Iterator

from fej_slam_ros.cli.arguments import number_option
from fej_slam_ros.cli.converters.common import add_paths, write
from fej_slam_ros.core.records import NS, Record, Scan
from fej_slam_ros.datasets.g2o import conversion, files
from fej_slam_ros.datasets.g2o.graph import Graph
from fej_slam_ros.errors import UserError

SUMMARY = 'a graph file of g2o, TORO, iSAM or GTSAM'


def add_arguments(parser: ArgumentParser) -> None:
    add_paths(parser, metavar='FILE', source='the graph, a text file')
    parser.add_argument(
        '--period', metavar='SECONDS', type=number_option('--period', 1e-3, 1e3),
        default=0.1, help='time between two poses of a robot, which graphs do not have (default:'
        ' %(default)s)')
    parser.add_argument(
        '--noise', choices=files.NOISES, default='covariance',
        help='what the numbers behind a measurement of ODOMETRY and LANDMARK are; GTSAM reads them'
        ' as covariances, iSAM as square roots of the information (default: %(default)s)')


def convert(arguments: Namespace) -> None:
    """Write the bag and print the number of its records."""
    graph, unused = files.read(arguments.input, arguments.noise)
    # Of what is no graph, such as a picture, each line begins with another word.
    others = ', '.join(sorted(name for name in unused if name.isprintable())[:6])
    try:
        team = conversion.trajectories(graph, round(arguments.period * NS))
        records = conversion.records(graph, team, unused)
    except UserError as error:
        raise UserError(
            f'{arguments.input}: {error}' + (f'; not used: lines of {others}' if others else '')
        ) from None
    write(
        records, conversion.settings(graph, team), arguments,
        _report(graph, team, unused, records))


def _report(
    graph: Graph, team: conversion.Trajectories, unused: Counter[str],
    records: Iterable[Record],
) -> Iterator[str]:
    landmarks = {edge.end for edge in graph.observations}
    observations: Counter[str] = Counter()
    for record in records:
        if isinstance(record, Scan):
            observations[record.robot] += len(record.observations)
    yield f'robots: {len(team.poses)}, landmarks: {len(landmarks)}'
    for robot, poses in team.poses.items():
        yield f'{robot}: poses: {len(poses)}, observations: {observations[robot]}'
    yield from (f'not used: {reason}: {count}' for reason, count in unused.items() if count)
