# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Smooth the ways and maps of all robots in a bag, and join the maps of robots that met.

Least squares over all that was measured. Each robot maps alone, in the frame <robot>/map; where
robots saw each other, or share numbers of landmarks, their maps become one, in the frame map if
the anchor is among them. Odometry must be uncertain in every direction. The parameters are those
of the node estimator or smoother.
"""

import argparse
from collections.abc import Iterator, Mapping

import numpy as np

from fej_slam_ros.cli import offline_run
from fej_slam_ros.cli.run_table import format_table, run_table
from fej_slam_ros.cli.smoother import ignored_parameters
from fej_slam_ros.core.csam.message_sizes import smallest
from fej_slam_ros.core.csam.team_solution import SmoothedMap, TeamMap
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.messages.common import from_time
from fej_slam_ros.ros.session.smoother_session import BagSmootherSession

HEADINGS = (
    'base node', 'frame', 'x [m]', 'y [m]', 'yaw [rad]', 'sigma x', 'sigma y', 'sigma yaw')
#: Bytes of each form of message that aligns two maps.
MESSAGE_HEADINGS = ('to align, from', 'to', 'subset [B]', 'log [B]', 'map [B]', 'smallest')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the verb."""
    offline_run.add_arguments(parser)
    parser.epilog = (
        f'Ignored parameters, of the estimator only: {", ".join(ignored_parameters())}.')


def run(arguments: argparse.Namespace) -> int:
    """Smooth the bag and print what came of it."""
    settings = parameters.load(arguments.params, ['estimator', 'smoother'])
    of_own_ids = not settings.estimation.shared_landmark_ids
    tables = [
        '\n'.join([
            run_table(told), _joined(made.team.solution, of_own_ids),
            *_messages(made.message_sizes)])
        for made, told in offline_run.process(
            arguments, settings, 'smoother', BagSmootherSession, SmoothedSink)]
    print('\n\n'.join(tables))
    return 0


class SmoothedSink(offline_run.BagSink):
    """Where publications go: into a bag, the poses at their stamps."""

    def logged_at(self, topic: str, message: Message) -> int:
        """Return when a message is said to have been recorded [ns]."""
        return from_time(message.header.stamp) if topic.endswith('/pose') else self.now


def _joined(solution: TeamMap, of_own_ids: bool) -> str:
    """Return how well each map fits, and where the joined ones lie."""
    lines = [
        f'{", ".join(solved.trajectories)} in {solved.frame}: chi-square {solved.chi_square:.1f} of'
        f' {solved.dof} degrees of freedom{_associated(solved) if of_own_ids else ""}'
        for solved in solution.maps]
    rows = [
        (name, solved.frame, *(f'{x:.4f}' for x in [*base.pose, *np.sqrt(np.diag(base.P))]))
        for solved in solution.maps for name, base in solved.base_nodes.items()]
    left_out = [
        f'of the meetings of {" and ".join(failed.robots)} is left out: {failed.reason}'
        for failed in solution.not_joined if solution.has_joined(failed.robots)]
    return '\n'.join([*lines, *left_out, *([format_table([HEADINGS, *rows])] if rows else [])])


def _messages(sizes: Mapping[tuple[str, str], Mapping[str, int]]) -> Iterator[str]:
    """Yield what a robot would send, before any map, for its map to be aligned."""
    if sizes:
        rows = [
            (*ends, *map(str, of.values()), smallest(of)) for ends, of in sizes.items()]
        yield format_table([MESSAGE_HEADINGS, *rows])


def _associated(solved: SmoothedMap) -> str:
    return f', {sum(len(names) > 1 for names in solved.landmarks)} landmarks associated'
