# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Check of the start poses and of the kind of landmark IDs, by further trial runs.

A team whose trial run is inconsistent, or in which robots restart, is estimated again with other
settings. If it is consistent with these, with fewer restarts, the given ones are wrong.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
import math

import numpy as np

from fej_slam_ros.core.geometry import Array, compose
from fej_slam_ros.core.ordering.impossible_motion import is_at_origin
from fej_slam_ros.core.records import Odometry
from fej_slam_ros.core.settings import RobotSettings, Settings, Triple
from fej_slam_ros.ros.doctor import team
from fej_slam_ros.ros.doctor.findings import error, Finding
from fej_slam_ros.ros.doctor.survey import Survey
from fej_slam_ros.ros.doctor.trial import Trial
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import RunSettings


def wrong_settings(
    settings: RunSettings, survey: Survey, trial: Trial,
    messages: Callable[[], Iterable[RawMessage]],
) -> tuple[list[Finding], Trial]:
    """Return the setting with another of which alone the trial is consistent, and that trial."""
    estimation = settings.estimation
    is_alone = len(estimation.robots) == 1
    restarts = team.restarts(trial) if team.is_consistent(trial) else math.inf
    if is_alone or settings.node.prior_landmarks or not restarts:
        return [], trial
    for finding, others in _other_settings(estimation, survey):
        other = Trial(others, settings.node)
        for message in messages():
            other.receive(message)
        other.close()
        # Maps by own IDs that agree show that the IDs are shared, and something else is wrong.
        if team.is_consistent(other) and team.restarts(other) < restarts and not (
                estimation.shared_landmark_ids and team.maps_agree(other)):
            return [finding], other
    return [], trial


def _other_settings(given: Settings, survey: Survey) -> Iterator[tuple[Finding, Settings]]:
    """Yield other settings, with the finding that only they are right."""
    placed = [robot.name for robot in given.robots if robot.start_pose is not None]
    if placed:
        yield from _late_starts(given, survey)
        yield error(
            'wrong_start', ', '.join(placed),
            'the start poses contradict the observations: all fit without them',
            'correct start_pose, give an honest start_sigma, or leave both out'
        ), replace(given, robots=tuple(
            replace(robot, start_pose=None) for robot in given.robots))
    kind, value = (
        ("each robot's own", 'false') if given.shared_landmark_ids else
        ('shared by all robots', 'true'))
    yield error(
        'wrong_ids', 'all robots',
        f'landmark IDs seem to be {kind}: only then do the observations fit',
        f'set the parameter shared_landmark_ids to {value}'
    ), replace(given, shared_landmark_ids=not given.shared_landmark_ids)


def _late_starts(given: Settings, survey: Survey) -> Iterator[tuple[Finding, Settings]]:
    """Yield start poses at the origins of odometry of robots that had moved before the bag."""
    others, cures = given, dict[str, str]()
    for robot in given.robots:
        stamps, poses = survey.odometry(robot.name).ordered()
        if len(poses) and not is_at_origin(Odometry(robot.name, int(stamps[0]), poses[0], None)):
            others, cure = _with_later_start(others, robot, poses[0])
            cures |= cure
    if cures:
        yield error(
            'late_start', ', '.join(cures),
            'the first odometry recorded is not at its origin, and start poses hold there: the'
            ' observations fit only if they are those of the origin',
            'record before the robots drive, or, for this bag only, set '
            + ', '.join(cures.values())), others


def _with_later_start(
    given: Settings, robot: RobotSettings, motion: Array
) -> tuple[Settings, dict[str, str]]:
    """Return settings with the start of a robot after a motion (3,), and the cure by robot."""
    if robot.name == given.anchor:
        start = _moved(given.anchor_pose, motion)
        return replace(given, anchor_pose=start), {robot.name: f'anchor_pose to {[*start]}'}
    if robot.start_pose is None:
        return given, {}
    start = _moved(robot.start_pose, motion)
    robots = (
        replace(other, start_pose=start) if other.name == robot.name else other
        for other in given.robots)
    return replace(given, robots=tuple(robots)), {
        robot.name: f'{robot.name}.start_pose to {[*start]}'}


def _moved(start: Triple, motion: Array) -> Triple:
    x, y, phi = np.round(compose(np.array(start), motion), 4).tolist()
    return x, y, phi
