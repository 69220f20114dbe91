# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Figures 5 and 6 of [Andersson]: two robots that join their maps, in one run."""

from collections.abc import Callable
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.experiments.andersson.experiment import (
    before_association, CsamSolution, EXPERIMENTS, heading_sigmas, in_own_frame, poses_of)
from fej_slam_ros.experiments.common.scene import draw_ellipse, TRUTH
from fej_slam_ros.palette import ROBOT_COLOURS

#: As in the paper, so that small ellipses can be seen.
SIGMAS = 18.0
BOTH = 'both robots'
#: Every so many samples a pose is drawn, as in the paper.
STRIDE = 4


def draw(file: BinaryIO, solved: CsamSolution, joint: JointMap) -> None:
    """Draw scene, gain by joining, heading sigmas and joint map of a run as a PNG."""
    experiment, seed = solved.task
    figure = Figure(figsize=(13.0, 12.0), layout='constrained')
    (scene, gained), (headings, joined) = figure.subplots(2, 2)
    _draw_scene(scene, solved)
    SECOND_PANEL[experiment](gained, solved, joint)
    _draw_headings(headings, solved, joint)
    _draw_map(joined, joint)
    joined.set_title("(d) joint map in the frame of P's start")
    for axes in (scene, gained, joined):
        axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', adjustable='datalim')
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.legend(
            loc='upper center', bbox_to_anchor=(0.5, -0.1), ncols=3, fontsize='small')
    figure.suptitle(
        f'Experiment {EXPERIMENTS[experiment]}, seed {seed}; ellipses of {SIGMAS:g} sigma')
    figure.savefig(file, dpi=110)


def _draw_scene(axes: Axes, solved: CsamSolution) -> None:
    truth = solved.truth
    points = np.array(list(truth.landmarks.values()))
    axes.plot(*points.T, '^', color='black', markersize=4, label='landmark')
    for (robot, poses), colour in zip(truth.true_poses.items(), ROBOT_COLOURS):
        axes.plot(*poses[:, :2].T, color=colour, linewidth=0.6, alpha=0.6)
        axes.plot(
            *poses[::STRIDE, :2].T, '.', color=colour, markersize=6,
            label=f'{robot.upper()}, every fourth sample')
        axes.plot(
            *poses[0, :2], 's', color=colour, markersize=9, fillstyle='none',
            label=f'start of {robot.upper()}')
    for met in solved.measurements:
        ends = (
            truth.true_poses[met.observer][met.pose],
            truth.true_poses[met.observed][met.observed_pose])
        axes.plot(*np.array(ends)[:, :2].T, color=ROBOT_COLOURS[2], linewidth=0.6, zorder=0)
    axes.plot([], [], color=ROBOT_COLOURS[2], label='observation of a robot')
    axes.set_title('(a) what is true')


def _draw_gain(axes: Axes, solved: CsamSolution, joint: JointMap) -> None:
    """Draw the map of Q in its own frame before and after joining."""
    q = solved.maps[1]
    own = in_own_frame(joint, q.robot)
    for of, colour, when in (
        (JointMap.of(q), TRUTH, 'before joining'), (own, ROBOT_COLOURS[1], 'after joining')
    ):
        numbers = of.landmark_index()
        seen = [numbers[key] for key in q.landmarks]
        P, P_points = of.information().marginals()
        ways = poses_of(of, q.robot)
        for x, P_x in zip(of.values.poses[ways][::STRIDE], P[ways][::STRIDE]):
            draw_ellipse(axes, x[:2], P_x[:2, :2], colour, SIGMAS)
        for point, P_point in zip(of.values.points[seen], P_points[seen]):
            draw_ellipse(axes, point, P_point, colour, SIGMAS)
        axes.plot(*of.values.poses[ways, :2].T, color=colour, linewidth=1.0, label=when)
    axes.plot(*own.values.points[seen].T, '^', color='black', markersize=3, label='landmark')
    axes.set_title("(b) Q's way and landmarks in the frame of Q's start")


def _draw_observations_only(axes: Axes, solved: CsamSolution, joint: JointMap) -> None:
    """Draw the map of both robots as it is before landmarks are associated."""
    _draw_map(axes, before_association(solved.maps, joint))
    axes.set_title("(b) by observations of Q alone, without associations, in P's frame")


#: What the second panel shows in each experiment.
SECOND_PANEL: dict[str, Callable[[Axes, CsamSolution, JointMap], None]] = {
    'map_joining': _draw_gain, 'sensor_extension': _draw_observations_only}


def _draw_headings(axes: Axes, solved: CsamSolution, joint: JointMap) -> None:
    for local, colour in zip(solved.maps, ROBOT_COLOURS):
        for of, line, when in (
            (JointMap.of(local), '--', 'before'), (joint, '-', 'joined')
        ):
            axes.plot(
                1e3 * heading_sigmas(of, local.robot), line, color=colour,
                label=f'{local.robot.upper()}, {when}')
    samples = [met.pose for met in solved.measurements]
    for sample in (min(samples), max(samples)):
        axes.axvline(sample, color=ROBOT_COLOURS[2], linewidth=1.0)
    axes.plot([], [], color=ROBOT_COLOURS[2], label='first and last rendezvous')
    axes.set(
        title='(c) heading sigma, each robot in the frame of its own start', xlabel='sample',
        ylabel='heading sigma [mrad]', ylim=(0.0, None))


def _draw_map(axes: Axes, of: JointMap) -> None:
    """Draw ways and landmarks of all robots with their covariances."""
    P, P_points = of.information().marginals()
    for robot, colour in zip(of.robots, ROBOT_COLOURS):
        poses, covariances = of.values.poses[poses_of(of, robot)], P[poses_of(of, robot)]
        axes.plot(*poses[:, :2].T, color=colour, linewidth=1.0, label=robot.upper())
        for x, P_x in zip(poses[::STRIDE], covariances[::STRIDE]):
            draw_ellipse(axes, x[:2], P_x[:2, :2], colour, SIGMAS)
    owners = [BOTH if len(keys) > 1 else keys[0][0].upper() for keys in of.landmarks]
    for owner, colour in zip((*map(str.upper, of.robots), BOTH), (*ROBOT_COLOURS[:2], ROBOT_COLOURS[3])):
        numbers = [number for number, other in enumerate(owners) if other == owner]
        for number in numbers:
            draw_ellipse(axes, of.values.points[number], P_points[number], colour, SIGMAS)
        if numbers:
            axes.plot(
                *of.values.points[numbers].T, '^', color=colour, markersize=3,
                label=f'landmark of {owner}')
