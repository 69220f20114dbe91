# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A rendezvous without a central node: two maps before, the alignment, and the map after it."""

from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from fej_slam_ros.core.csam.base_node import BaseNode
from fej_slam_ros.core.csam.maps import JointMap, LocalMap
from fej_slam_ros.core.geometry import Array, transform, transform_poses
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.experiments.andersson.exchange import Exchanged, LOSS
from fej_slam_ros.experiments.andersson.experiment import CsamSolution
from fej_slam_ros.experiments.andersson.figure import draw_map
from fej_slam_ros.experiments.common.drawing import draw_ellipses
from fej_slam_ros.palette import ROBOT_COLOURS

SIGMAS = 3.0


def draw(file: BinaryIO, solution: CsamSolution, joint: JointMap, exchanged: Exchanged) -> None:
    """Draw the maps of P and Q, what P knows after the information, and the joint map as a PNG."""
    p, q = map(JointMap.of, solution.maps)
    figure = Figure(figsize=(13.0, 12.0), layout='constrained')
    (own, other), (aligned, joined) = figure.subplots(2, 2)
    _draw_own(own, p, solution.maps[0], ROBOT_COLOURS[0])
    own.set_title("(a) P's map in P's frame, before")
    _draw_own(other, q, solution.maps[1], ROBOT_COLOURS[1])
    other.set_title("(b) Q's map in Q's frame, before")
    _draw_own(aligned, p, solution.maps[0], ROBOT_COLOURS[0])
    rendezvous = exchanged.rendezvous
    if not isinstance(rendezvous.alignment, JoinFailure):
        _draw_base_node(aligned, rendezvous.alignment.base_node, rendezvous.pose)
    aligned.set_title(
        f'(c) P knows where Q is and was: {exchanged.bytes_to_align / 1e3:.1f} kB sent by both')
    draw_map(joined, joint, SIGMAS)
    joined.set_title(
        f'(d) the map of both, at P and at Q: {exchanged.bytes_in_all / 1e3:.0f} kB sent by both')
    for axes in figure.axes:
        axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', adjustable='datalim')
        axes.grid(alpha=0.25)
        axes.legend(loc='upper center', bbox_to_anchor=(0.5, -0.1), ncols=3, fontsize='small')
    figure.suptitle(
        f'A rendezvous over a link that loses {100.0 * LOSS:.0f} % of the messages, experiment A,'
        f' seed {solution.task.seed}')
    figure.savefig(file, dpi=110)


def _draw_own(axes: Axes, joint: JointMap, local: LocalMap, colour: str) -> None:
    """Draw a map in its own frame, with ellipses."""
    _, P = joint.information().marginals()
    name = local.robot.upper()
    axes.plot(*joint.values.poses[:, :2].T, color=colour, linewidth=1.0, label=name)
    axes.plot(*joint.values.points.T, '^', color=colour, markersize=3, label=f'landmark of {name}')
    draw_ellipses(axes, joint.values.points, P, colour, SIGMAS)


def _draw_base_node(axes: Axes, base: BaseNode, pose: Array | None) -> None:
    """Draw the start of Q, with its axes and ellipse, and Q where it was last seen."""
    colour = ROBOT_COLOURS[1]
    origin, *ends = transform(base.pose, np.array([[0.0, 0.0], [1.5, 0.0], [0.0, 1.5]]))
    for end in ends:
        axes.plot(*np.array([origin, end]).T, color=colour, linewidth=1.5)
    axes.plot(*origin, 's', color=colour, fillstyle='none', markersize=9, label='start of Q')
    draw_ellipses(axes, base.pose[None], base.P[None], colour, SIGMAS)
    if pose is not None:
        ahead = transform_poses(pose, np.array([[0.8, 0.0, 0.0]]))[0]
        axes.annotate(
            '', (ahead[0], ahead[1]), (pose[0], pose[1]),
            arrowprops={'arrowstyle': '->', 'color': colour})
        axes.plot(*pose[:2], 'o', color=colour, label='Q where it was last seen')
