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
    before_association, CsamSolution, EXPERIMENTS, heading_sigmas, in_own_frame)
from fej_slam_ros.experiments.common.drawing import draw_ellipses, TRUTH_COLOUR
from fej_slam_ros.palette import ROBOT_COLOURS

#: Size of ellipses, as in the paper, so that small ones are visible.
PAPER_SIGMAS = 18.0
BOTH_ROBOTS = 'both robots'
#: Samples between two drawn poses, as in the paper.
POSE_STRIDE = 4


def draw(file: BinaryIO, solution: CsamSolution, joint: JointMap) -> None:
    """Draw scene, effect of joining, heading sigmas and joint map of a run as a PNG."""
    experiment, seed = solution.task
    figure = Figure(figsize=(13.0, 12.0), layout='constrained')
    (scene, effect), (headings, joined) = figure.subplots(2, 2)
    _draw_scene(scene, solution)
    SECOND_PANEL[experiment](effect, solution, joint)
    _draw_headings(headings, solution, joint)
    draw_map(joined, joint)
    joined.set_title("(d) joint map in the frame of P's start")
    for axes in (scene, effect, joined):
        axes.set(xlabel='x [m]', ylabel='y [m]', aspect='equal', adjustable='datalim')
    for axes in figure.axes:
        axes.grid(alpha=0.25)
        axes.legend(
            loc='upper center', bbox_to_anchor=(0.5, -0.1), ncols=3, fontsize='small')
    figure.suptitle(
        f'Experiment {EXPERIMENTS[experiment]}, seed {seed}; {PAPER_SIGMAS:g}-sigma ellipses')
    figure.savefig(file, dpi=110)


def _draw_scene(axes: Axes, solution: CsamSolution) -> None:
    truth = solution.truth
    points = np.array(list(truth.landmarks.values()))
    axes.plot(*points.T, '^', color='black', markersize=4, label='landmark')
    for (robot, poses), colour in zip(truth.true_poses.items(), ROBOT_COLOURS):
        axes.plot(*poses[:, :2].T, color=colour, linewidth=0.6, alpha=0.6)
        axes.plot(
            *poses[::POSE_STRIDE, :2].T, '.', color=colour, markersize=6,
            label=f'{robot.upper()}, every fourth sample')
        axes.plot(
            *poses[0, :2], 's', color=colour, markersize=9, fillstyle='none',
            label=f'start of {robot.upper()}')
    for one in solution.measurements:
        ends = (truth.true_poses[one.observer][one.pose],
                truth.true_poses[one.observed][one.observed_pose])
        axes.plot(*np.array(ends)[:, :2].T, color=ROBOT_COLOURS[2], linewidth=0.6, zorder=0)
    axes.plot([], [], color=ROBOT_COLOURS[2], label='observation of a robot')
    axes.set_title('(a) ground truth')


def _draw_gain(axes: Axes, solution: CsamSolution, joint: JointMap) -> None:
    """Draw the map of Q in its own frame before and after joining."""
    q = solution.maps[1]
    own = in_own_frame(joint, q.robot)
    for q_map, colour, label in (
        (JointMap.of(q), TRUTH_COLOUR, 'before joining'), (own, ROBOT_COLOURS[1], 'after joining')
    ):
        indices = q_map.landmark_index()
        landmarks = [indices[key] for key in q.landmarks]
        P, P_points = q_map.information().marginals()
        poses = q_map.poses_of(q.robot)
        drawn = slice(poses.start, poses.stop, POSE_STRIDE)
        draw_ellipses(axes, q_map.values.poses[drawn], P[drawn], colour, PAPER_SIGMAS)
        draw_ellipses(
            axes, q_map.values.points[landmarks], P_points[landmarks], colour, PAPER_SIGMAS)
        axes.plot(*q_map.values.poses[poses, :2].T, color=colour, linewidth=1.0, label=label)
    axes.plot(*own.values.points[landmarks].T, '^', color='black', markersize=3, label='landmark')
    axes.set_title("(b) Q's trajectory and landmarks in the frame of Q's start")


def _draw_without_association(axes: Axes, solution: CsamSolution, joint: JointMap) -> None:
    """Draw the map of both robots before landmarks are associated."""
    draw_map(axes, before_association(solution.maps, joint))
    axes.set_title("(b) in P's frame, joined by observations of Q alone")


#: Content of the second panel in each experiment.
SECOND_PANEL: dict[str, Callable[[Axes, CsamSolution, JointMap], None]] = {
    'map_joining': _draw_gain, 'sensor_extension': _draw_without_association}


def _draw_headings(axes: Axes, solution: CsamSolution, joint: JointMap) -> None:
    for local, colour in zip(solution.maps, ROBOT_COLOURS):
        for own_map, line, label in (
            (JointMap.of(local), '--', 'before'), (joint, '-', 'joined')
        ):
            axes.plot(
                1e3 * heading_sigmas(own_map, local.robot), line, color=colour,
                label=f'{local.robot.upper()}, {label}')
    samples = [one.pose for one in solution.measurements]
    for sample in (min(samples), max(samples)):
        axes.axvline(sample, color=ROBOT_COLOURS[2], linewidth=1.0)
    axes.plot([], [], color=ROBOT_COLOURS[2], label='first and last rendezvous')
    axes.set(
        title='(c) heading sigma, each robot in the frame of its own start', xlabel='sample',
        ylabel='heading sigma [mrad]', ylim=(0.0, None))


def draw_map(axes: Axes, joint: JointMap, sigmas: float = PAPER_SIGMAS) -> None:
    """Draw trajectories and landmarks of all robots with their covariances."""
    P, P_points = joint.information().marginals()
    for robot, colour in zip(joint.robots, ROBOT_COLOURS):
        poses = joint.poses_of(robot)
        axes.plot(
            *joint.values.poses[poses, :2].T, color=colour, linewidth=1.0, label=robot.upper())
        drawn = slice(poses.start, poses.stop, POSE_STRIDE)
        draw_ellipses(axes, joint.values.poses[drawn], P[drawn], colour, sigmas)
    owners = np.array([
        BOTH_ROBOTS if len(keys) > 1 else keys[0][0].upper() for keys in joint.landmarks])
    names = (*map(str.upper, joint.robots), BOTH_ROBOTS)
    for owner, colour in zip(names, (*ROBOT_COLOURS[:2], ROBOT_COLOURS[3])):
        points = joint.values.points[owners == owner]
        draw_ellipses(axes, points, P_points[owners == owner], colour, sigmas)
        if len(points):
            axes.plot(*points.T, '^', color=colour, markersize=3, label=f'landmark of {owner}')
