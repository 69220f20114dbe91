# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Smooth the trajectories and maps of all robots in a bag, and merge the maps of robots that met.

C-SAM: least squares over all measurements. Each robot maps alone in the frame <robot>/map. Maps
merge where robots observed each other or share landmark IDs; the merged map is in the frame map if
it contains the anchor. Odometry must have noise in every direction. Parameters are those of the
node estimator or smoother.

Observations without IDs get those of the landmarks that the estimator matches them with, as in
`replay`, before they are smoothed.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from fej_slam_ros.cli import offline_run
from fej_slam_ros.cli.bag_input import matches_in
from fej_slam_ros.cli.run_table import matched_in_words, run_table
from fej_slam_ros.cli.smoother import ignored_parameters
from fej_slam_ros.cli.topic_options import names_in, node_names
from fej_slam_ros.core.csam.message_sizes import smallest
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.sentences import counted
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.session.smoother_session import BagSmootherSession
from fej_slam_ros.tables import text_table

#: Chi-square over its degrees of freedom above which covariances do not describe the errors.
MAX_CHI_SQUARE_RATIO = 2.0
#: Largest number of intervals of released odometry that are listed.
MAX_INTERVALS = 3
BASE_NODE_HEADINGS = (
    'base node', 'frame', 'x [m]', 'y [m]', 'yaw [rad]', 'sigma x', 'sigma y', 'sigma yaw')
MESSAGE_HEADINGS = ('message from', 'to', 'subset [B]', 'log [B]', 'map [B]', 'smallest')
#: What the table of these is about.
MESSAGES = (
    'Size of one message that lets a robot align its map with that of a robot it met: the subset'
    ' of\nrendezvous poses with their information, all measurements, or the whole map.')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    offline_run.add_arguments(parser)
    parser.add_argument(
        '--restore', metavar='CHECKPOINT', default='',
        help='continue from a checkpoint of the node smoother; input from before it may be in the'
             ' bag again')
    ignored = ', '.join((*ignored_parameters(), 'checkpoint', 'autosave_period', 'restore'))
    parser.epilog = (
        f'Ignored parameters, of the estimator or of live runs only: {ignored}. Those of the'
        ' estimator are used to match observations without IDs.')


def run(arguments: argparse.Namespace) -> int:
    settings = _settings(arguments)
    matches = None if arguments.restore else matches_in(
        arguments.bag, settings, names_in(arguments, arguments.bag))
    runs = offline_run.process(
        arguments, settings, 'smoother', partial(BagSmootherSession, matches=matches),
        SmoothedSink)
    if matches is not None:
        print(matched_in_words(matches.counts))
    offline_run.print_tables(arguments, [session for session, _ in runs], [
        '\n'.join([run_table(summary), *_tables(session)]) for session, summary in runs])
    return 0


def _settings(arguments: argparse.Namespace) -> parameters.RunSettings:
    settings = parameters.load(
        arguments.params, node_names(arguments, 'estimator', 'smoother'))
    # Those of the parameters are of live runs, perhaps of the estimator.
    return replace(settings, node=replace(
        settings.node, checkpoint='', restore=arguments.restore))


class SmoothedSink(offline_run.BagSink[BagSmootherSession]):
    """Writer of publications to a bag, with the smoothed poses logged at their stamps."""

    def close(self, session: BagSmootherSession) -> None:
        super().close(session)
        self.write(session.smoothed_poses())

    def log_time(self, topic: str, message: Message) -> int:
        return from_time(message.header.stamp) if topic.endswith('/pose') else self.now


def _tables(session: BagSmootherSession) -> Iterator[str]:
    """Yield fits of maps, rejected rendezvous, slips, base nodes, and sizes of messages."""
    solution = session.team.solution
    own_ids = not session.settings.estimation.shared_landmark_ids
    for solved in solution.maps:
        associated = sum(len(names) > 1 for names in solved.landmarks)
        yield (
            f'{", ".join(solved.trajectories)} in {solved.frame}: chi-square'
            f' {solved.chi_square:.1f}, {solved.dof} degrees of freedom'
            + (f', {associated} landmarks associated' if own_ids else ''))
        if solved.chi_square > MAX_CHI_SQUARE_RATIO * solved.dof > 0.0:
            yield (
                f'chi-square is {solved.chi_square / solved.dof:.1f} times its degrees of freedom:'
                ' covariances are too small, or measurements wrong; doctor names some faults')
    for failed in solution.not_joined:
        if solution.has_joined(failed.robots):
            yield f'a rendezvous of {" and ".join(failed.robots)} is left out: {failed.reason}'
    for join in solution.scaled:
        yield (
            f'the map of {" and ".join(join.robots)} was {abs(join.scale - 1.0):.1%}'
            f' {"larger" if join.scale > 1.0 else "smaller"} than that of'
            f' {" and ".join(join.others)}: fej_slam calibrate finds wrong ranges and odometry')
    for released in session.released_odometry():
        yield (
            f'released odometry of {released["robot"]} {_times(released["intervals_ns"])}:'
            f' {counted(released["observations"], "observation")} contradicted it. The wheels'
            ' slipped, or the robot was carried')
    rows = [
        (name, solved.frame, *(f'{x:.4f}' for x in [*base.pose, *np.sqrt(np.diag(base.P))]))
        for solved in solution.maps for name, base in solved.base_nodes.items()]
    if rows:
        yield text_table(BASE_NODE_HEADINGS, rows)
    if session.message_sizes:
        yield '\n' + MESSAGES
        yield text_table(MESSAGE_HEADINGS, (
            (*robots, *map(str, by_form.values()), smallest(by_form))
            for robots, by_form in session.message_sizes.items()))


def _times(intervals: Sequence[Sequence[int]]) -> str:
    """Return a text with the begin and end [ns] of some intervals."""
    times = [f'from {begin / NS:.1f} to {end / NS:.1f} s' for begin, end in intervals]
    if len(times) <= MAX_INTERVALS:
        return ' and '.join(times)
    begin, end = intervals[0][0], intervals[-1][1]
    return f'in {len(times)} intervals from {begin / NS:.1f} to {end / NS:.1f} s'
