# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
A set of MRCLAM, five real robots, with each filter, with and without observations of robots.

All robots but the anchor start at unknown places. The ground truth is that of motion capture; what
it does not tell does not count.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
import time
from typing import Any

import numpy as np

from fej_slam_ros.core.consistency import mean_nis, nees
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import (
    Array, between, compose, poses_at, rigid_fit, transform, transform_poses, wrap_all)
from fej_slam_ros.core.records import Record
from fej_slam_ros.datasets.mrclam import conversion, files
from fej_slam_ros.datasets.mrclam.conversion import Reading, robot_name
from fej_slam_ros.datasets.mrclam.files import Series
from fej_slam_ros.datasets.mrclam.noise import can_tell, measured
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.common.markdown import table
from fej_slam_ros.experiments.liu.metrics import root_mean_square

FILTERS = ('standard', 'fej', 'invariant')

MEANING = """\
Robots run together from the commands, scaled, delayed and with the noise that `convert mrclam`
measures; all but the anchor start at unknown places. Position and heading are one root of the mean
square over all true poses of all robots, as estimated (in the frame in which the anchor's start is
given) and after one rigid fit of all robots; NEES/3 and NIS/2 are means. Landmarks are compared
after the same fit. Dead reckoning starts each robot at its true pose."""

TITLES = (
    'filter', 'observations of robots', 'position [m]', 'after a fit [m]', 'worst robot [m]',
    'heading [rad]', 'after a fit [rad]', 'NEES/3', 'NIS/2', 'landmarks', 'landmarks [m]',
    'in map, least [%]', 'time [s]')


@dataclass(frozen=True)
class MrclamTask:
    """A run: the folder of the set, the filter, and whether observations of robots are used."""

    folder: Path
    filter: str
    robots_seen: bool


@dataclass(frozen=True, slots=True)
class MrclamRun:
    """
    What came of a task.

    Attributes
    ----------
    task : what was to be done
    position, heading : RMSE as estimated [m, rad]
    fitted_position, fitted_heading : RMSE after a rigid fit of all robots [m, rad]
    of_robots : fitted position RMSE of each robot alone [m]
    nees, nis : means, divided by 3 and by 2
    landmarks, true_landmarks : how many were mapped, and how many there are
    landmark_rmse : of those, after the same fit [m]
    in_map : of each robot, which part of its poses is in the common map
    dead_reckoning : RMSE of odometry alone, of each robot [m]
    seconds : how long it took

    """

    task: MrclamTask
    position: float
    heading: float
    fitted_position: float
    fitted_heading: float
    of_robots: Mapping[str, float]
    nees: float
    nis: float
    landmarks: int
    true_landmarks: int
    landmark_rmse: float
    in_map: Mapping[str, float]
    dead_reckoning: Mapping[str, float]
    seconds: float


@dataclass(slots=True, eq=False)
class Steps:
    """
    A robot at its steps.

    Attributes
    ----------
    stamps : [ns]
    poses, P : what is estimated, with its covariance
    odometry : where odometry alone has it
    in_map : whether it is in ``map``

    """

    stamps: list[int] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    P: list[Array] = field(default_factory=list)
    odometry: list[Array] = field(default_factory=list)
    in_map: list[bool] = field(default_factory=list)

    def add(self, estimate: PoseEstimate, odometry: Array) -> None:
        """Take in a step."""
        self.stamps.append(estimate.stamp)
        self.poses.append(estimate.pose)
        self.P.append(estimate.P)
        self.odometry.append(odometry)
        self.in_map.append(estimate.frame == MAP)


@dataclass(frozen=True, slots=True, eq=False)
class ErrorsOverTime:
    """
    A robot where the truth of it is known.

    Attributes
    ----------
    estimated, true : (n, 3) arrays, the poses in ``map``
    nees : (n,) array, divided by 3
    drift : (m, 2) array, how far odometry alone is from the truth, also before the robot is in map
    in_map : which part of all its steps is in ``map``

    """

    estimated: Array
    true: Array
    nees: Array
    drift: Array
    in_map: float


def tasks(folder: Path) -> list[MrclamTask]:
    """Return all runs on the set in a folder."""
    return [MrclamTask(folder, name, seen) for seen in (True, False) for name in FILTERS]


def run(task: MrclamTask) -> MrclamRun:
    """
    Return what a filter makes of a set.

    Raises
    ------
    UserError
        There is no set in the folder, or not of all the ground truth, or too few observations.

    """
    data = files.read(task.folder)
    reading = measured(data) if can_tell(data) else Reading()
    reading = replace(reading, robot_observations=task.robots_seen)
    untold = [
        robot_name(robot) for robot, log in data.logs.items()
        if not len(conversion.truth(log, reading))]
    if untold or not data.landmarks:
        raise UserError(
            f'{task.folder} has no ground truth of {", ".join(untold) or "landmarks"} to judge by:'
            ' take another set, or convert and replay it')
    settings = replace(conversion.settings(data, reading), filter=task.filter)
    counts: dict[int, Counter[str]] = {robot: Counter() for robot in data.logs}
    estimator = Estimator(settings)
    begin = time.perf_counter()
    steps = _steps(estimator, conversion.records(data, reading, counts))
    seconds = time.perf_counter() - begin
    courses = {
        robot_name(robot): _course(steps[robot_name(robot)], log.truth)
        for robot, log in data.logs.items()}
    points = {
        landmark.id: (landmark.position, data.landmarks[landmark.id])
        for landmark in estimator.landmarks() if landmark.id in data.landmarks}
    if not points or not any(monitor.dof for monitor in estimator.innovations.nis.values()):
        raise UserError(
            f'{task.folder} has no known landmark that is seen twice to judge by: take another'
            ' set, or convert and replay it')
    return _judged(task, estimator, courses, points, len(data.landmarks), seconds)


def markdown(runs: Sequence[MrclamRun]) -> str:
    """Return the runs as a page."""
    drift = ', '.join(
        f'{name} {rmse:.2f}' for name, rmse in runs[0].dead_reckoning.items())
    return '\n\n'.join([
        '# MRCLAM', MEANING, table(TITLES, map(_row, runs), words=(0, 1)),
        f'Dead reckoning, position RMSE [m]: {drift}.']) + '\n'


def summary(runs: Sequence[MrclamRun]) -> list[dict[str, Any]]:
    """Return the runs in a form that JSON knows."""
    return [{
        **asdict(of), 'task': {'filter': of.task.filter, 'robots_seen': of.task.robots_seen}}
        for of in runs]


def _steps(estimator: Estimator, records: Iterable[Record]) -> dict[str, Steps]:
    """Return the steps of each robot."""
    steps: defaultdict[str, Steps] = defaultdict(Steps)
    for result in estimator.run(records):
        for estimate in result.poses:
            steps[estimate.robot].add(estimate, result.odometry[estimate.robot])
    return steps


def _course(steps: Steps, truth: Series) -> ErrorsOverTime:
    """Return a robot at the stamps of its ground truth, between two steps each."""
    stamps, in_map = np.array(steps.stamps), np.array(steps.in_map)
    truth = truth.where((truth.stamps >= stamps[0]) & (truth.stamps <= stamps[-1]))
    after = np.searchsorted(stamps, truth.stamps)
    told = in_map[after] & in_map[(after - 1).clip(0)]
    estimated = poses_at(truth.stamps, stamps, np.array(steps.poses))[told]
    error = estimated - truth.rows[told]
    error[:, 2] = wrap_all(error[:, 2])
    # Odometry from where the truth begins.
    odometry = poses_at(truth.stamps, stamps, np.array(steps.odometry))
    begin = compose(truth.rows[0], between(odometry[0], np.zeros(3)))
    drift = transform_poses(begin, odometry) - truth.rows
    return ErrorsOverTime(
        estimated, truth.rows[told], nees(error, np.array(steps.P)[after][told]), drift[:, :2],
        float(in_map.mean()))


def _judged(
    task: MrclamTask, estimator: Estimator, courses: Mapping[str, ErrorsOverTime],
    points: Mapping[int, tuple[Array, Array]], true_landmarks: int, seconds: float,
) -> MrclamRun:
    estimated, true = (
        np.vstack([getattr(course, what) for course in courses.values()])
        for what in ('estimated', 'true'))
    pose = rigid_fit(estimated[:, :2], true[:, :2])
    fitted = transform_poses(pose, estimated)
    of_robots = {
        name: root_mean_square(transform_poses(pose, course.estimated)[:, :2] - course.true[:, :2])
        for name, course in courses.items()}
    rated = np.concatenate([course.nees for course in courses.values()])
    mapped, there = map(np.array, zip(*points.values()))
    return MrclamRun(
        task,
        root_mean_square(estimated[:, :2] - true[:, :2]),
        root_mean_square(wrap_all(estimated[:, 2:] - true[:, 2:])),
        root_mean_square(fitted[:, :2] - true[:, :2]),
        root_mean_square(wrap_all(fitted[:, 2:] - true[:, 2:])),
        of_robots, float(rated.mean()), mean_nis(estimator.innovations.nis.values()),
        len(estimator.landmarks()), true_landmarks,
        root_mean_square(transform(pose, mapped) - there),
        {name: course.in_map for name, course in courses.items()},
        {name: root_mean_square(course.drift) for name, course in courses.items()}, seconds)


def _row(of: MrclamRun) -> list[str]:
    return [
        of.task.filter, 'used' if of.task.robots_seen else 'left out',
        f'{of.position:.3f}', f'{of.fitted_position:.3f}', f'{max(of.of_robots.values()):.3f}',
        f'{of.heading:.4f}', f'{of.fitted_heading:.4f}', f'{of.nees:.2f}', f'{of.nis:.2f}',
        f'{of.landmarks} of {of.true_landmarks}', f'{of.landmark_rmse:.3f}',
        f'{100.0 * min(of.in_map.values()):.1f}', f'{of.seconds:.0f}']
