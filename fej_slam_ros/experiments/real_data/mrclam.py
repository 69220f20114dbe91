# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
MRCLAM sets, up to five real robots: each filter with and without robot-to-robot observations.

All robots but the anchor have unknown starts. Ground truth is motion capture; times and robots
without it are not evaluated.
"""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
import time
from typing import Any

import numpy as np

from fej_slam_ros.core.consistency import mean_nis, nees_per_dof
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import (
    Array, compose, inverse, poses_at, rigid_fit, transform, transform_poses, wrap_all)
from fej_slam_ros.datasets.mrclam import conversion, files
from fej_slam_ros.datasets.mrclam.conversion import ConversionOptions, robot_name
from fej_slam_ros.datasets.mrclam.files import MrclamSet
from fej_slam_ros.datasets.mrclam.noise import best_options
from fej_slam_ros.datasets.mrclam.series import Series
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.liu.metrics import root_mean_square
from fej_slam_ros.tables import markdown_table

MRCLAM_FILTERS = ('standard', 'fej', 'invariant')
MRCLAM_NOTES = """\
Robots run from the commands, scaled, delayed and with the noise that `convert mrclam` measures;
all but the anchor have unknown starts. Position and heading errors are root mean squares over all
true poses of all robots, as estimated (in the frame of the anchor's given start) and after one
rigid fit of all robots; NEES/3 and NIS/2 are means. Landmarks are compared after the same fit.
Robots without ground truth take part and are not evaluated. Dead reckoning starts each robot at
its true pose."""
MRCLAM_TITLES = (
    'set', 'filter', 'robot-to-robot observations', 'position [m]', 'after a fit [m]',
    'worst robot [m]', 'heading [rad]', 'after a fit [rad]', 'NEES/3', 'NIS/2', 'landmarks',
    'landmarks [m]', 'in map, least [%]', 'time [s]')
#: A robot's pose after each step, and its pose by odometry alone.
Steps = list[tuple[PoseEstimate, Array]]


@dataclass(frozen=True)
class MrclamTask:
    """A run: folder of the set, filter, and whether robot-to-robot observations are used."""

    folder: Path
    filter: str
    robots_seen: bool

    @property
    def name(self) -> str:
        """Return the name of the set."""
        return self.folder.resolve().name


@dataclass(frozen=True, slots=True)
class MrclamRun:
    """Results of a run."""

    task: MrclamTask  #: The run
    #: RMSE as estimated [m, rad].
    position: float
    heading: float
    #: RMSE after a rigid fit of all robots [m, rad].
    fitted_position: float
    fitted_heading: float
    of_robots: Mapping[str, float]  #: Fitted position RMSE of each robot [m]
    #: Means, divided by 3 and by 2.
    nees: float
    nis: float
    #: Number of landmarks in the map, and in the data set.
    landmarks: int
    true_landmarks: int
    landmark_rmse: float  #: RMSE of the landmarks after the same fit [m]
    in_map: Mapping[str, float]  #: Fraction of each robot's poses that are in the common map
    dead_reckoning: Mapping[str, float]  #: Position RMSE of odometry alone, of each robot [m]
    seconds: float  #: Processing time


@dataclass(frozen=True, slots=True, eq=False)
class MrclamErrors:
    """A robot at the stamps with ground truth."""

    #: (n, 3) arrays, the poses in ``map``.
    estimated: Array
    true: Array
    nees: Array  #: (n,) array, NEES/3
    #: (m, 2) array, position errors of odometry alone, also before the robot is in ``map``.
    drift: Array
    in_map: float  #: Fraction of all its steps that are in ``map``


def sets(folder: Path) -> tuple[list[Path], dict[str, str]]:
    """
    Return the sets in a folder, itself one or with a folder for each.

    Returns
    -------
    usable : folders of the sets, in the order of their names
    refused : reasons to leave others out, by name

    Raises
    ------
    UserError
        No set can be evaluated.

    """
    if (folder / 'Barcodes.dat').is_file() or not any(folder.glob('*/Barcodes.dat')):
        _evaluable(folder)
        return [folder], {}
    usable, refused = [], {}
    for path in sorted(path.parent for path in folder.glob('*/Barcodes.dat')):
        try:
            _evaluable(path)
        except UserError as error:  # noqa: PERF203
            refused[path.name] = str(error)
        else:
            usable.append(path)
    if not usable:
        raise UserError('; '.join(refused.values()))
    return usable, refused


def tasks(folders: Sequence[Path]) -> list[MrclamTask]:
    """Return all runs on some sets."""
    return [
        MrclamTask(folder, name, used) for folder in folders for used in (True, False)
        for name in MRCLAM_FILTERS]


def run(task: MrclamTask) -> MrclamRun:
    """Run a filter on a set, which must have ground truth and observations, and evaluate it."""
    data, options = _evaluable(task.folder)
    options = replace(options, robot_observations=task.robots_seen)
    data = conversion.with_known_anchor(data, options)
    estimator = Estimator(replace(conversion.settings(data, options), filter=task.filter))
    counts: dict[int, Counter[str]] = {robot: Counter() for robot in data.logs}
    steps: defaultdict[str, Steps] = defaultdict(list)
    begin = time.perf_counter()
    for result in estimator.run(conversion.records(data, options, counts)):
        for estimate in result.poses:
            steps[estimate.robot].append((estimate, result.odometry[estimate.robot]))
    seconds = time.perf_counter() - begin
    errors = {}
    for robot, log in data.logs.items():
        of_robot = steps[robot_name(robot)]
        true = log.truth.between(of_robot[0][0].stamp, of_robot[-1][0].stamp)
        if len(true):
            errors[robot_name(robot)] = _errors(of_robot, true)
    return _evaluated(task, estimator, errors, data.landmarks, seconds)


def markdown(runs: Sequence[MrclamRun]) -> str:
    """Return the runs as a page."""
    first_of_set = {of.task.name: of for of in reversed(runs)}
    drifts = [
        f'{name}: {", ".join(f"{robot} {e:.2f}" for robot, e in of.dead_reckoning.items())}'
        for name, of in sorted(first_of_set.items())]
    return '\n\n'.join([
        '# MRCLAM', MRCLAM_NOTES, markdown_table(MRCLAM_TITLES, map(_row, runs), (0, 1, 2)),
        f'Dead reckoning, position RMSE [m]: {"; ".join(drifts)}.']) + '\n'


def summary(runs: Sequence[MrclamRun]) -> list[dict[str, Any]]:
    """Return the runs for a JSON file."""
    return [asdict(of) | {'task': {
        'set': of.task.name, 'filter': of.task.filter, 'robots_seen': of.task.robots_seen}}
        for of in runs]


def _evaluable(folder: Path) -> tuple[MrclamSet, ConversionOptions]:
    """Return a set and its options; raise a `UserError` if there is nothing to compare with."""
    data = files.read(folder)
    options = best_options(data)
    if not data.landmarks or not any(
            len(conversion.truth(log, options)) for log in data.logs.values()):
        names = ', '.join(map(robot_name, data.logs)) if data.landmarks else 'landmarks'
        raise UserError(
            f'{folder} has no ground truth of {names} to evaluate with: take another set, or'
            ' convert and replay it')
    return data, options


def _errors(steps: Steps, truth: Series) -> MrclamErrors:
    """Return a robot's errors at stamps with ground truth between its first and last step."""
    stamps = np.array([estimate.stamp for estimate, _ in steps])
    in_map = np.array([estimate.frame == MAP for estimate, _ in steps])
    after = np.searchsorted(stamps, truth.stamps)
    used = in_map[after] & in_map[(after - 1).clip(0)]
    poses = np.array([estimate.pose for estimate, _ in steps])
    estimated = poses_at(truth.stamps, stamps, poses)[used]
    error = estimated - truth.rows[used]
    error[:, 2] = wrap_all(error[:, 2])
    P = np.array([estimate.P for estimate, _ in steps])[after][used]
    # Odometry is aligned with the first true pose.
    odometry = poses_at(truth.stamps, stamps, np.array([pose for _, pose in steps]))
    begin = compose(truth.rows[0], inverse(odometry[0]))
    drift = transform_poses(begin, odometry) - truth.rows
    return MrclamErrors(
        estimated, truth.rows[used], nees_per_dof(error, P), drift[:, :2], float(in_map.mean()))


def _evaluated(
    task: MrclamTask, estimator: Estimator, errors: Mapping[str, MrclamErrors],
    true_landmarks: Mapping[int, Array], seconds: float,
) -> MrclamRun:
    landmarks = estimator.landmarks()
    points = [
        (landmark.position, true_landmarks[landmark.id])
        for landmark in landmarks if landmark.id in true_landmarks]
    if not points or not any(monitor.dof for monitor in estimator.innovations.nis.values()):
        raise UserError(
            f'{task.folder} has no known landmark that is observed twice to evaluate with: take'
            ' another set, or convert and replay it')
    mapped, true_points = map(np.array, zip(*points))
    estimated = np.vstack([of_robot.estimated for of_robot in errors.values()])
    true = np.vstack([of_robot.true for of_robot in errors.values()])
    fit = rigid_fit(estimated[:, :2], true[:, :2])
    return MrclamRun(
        task, *_rmse(estimated, true), *_rmse(transform_poses(fit, estimated), true),
        {name: _rmse(transform_poses(fit, of_robot.estimated), of_robot.true)[0]
         for name, of_robot in errors.items() if len(of_robot.estimated)},
        float(np.concatenate([of_robot.nees for of_robot in errors.values()]).mean()),
        mean_nis(estimator.innovations.nis.values()), len(landmarks), len(true_landmarks),
        root_mean_square(transform(fit, mapped) - true_points),
        {name: of_robot.in_map for name, of_robot in errors.items()},
        {name: root_mean_square(of_robot.drift) for name, of_robot in errors.items()}, seconds)


def _rmse(estimated: Array, true: Array) -> tuple[float, float]:
    """Return the RMSE of positions [m] and headings [rad] of poses (n, 3)."""
    errors = estimated - true
    return root_mean_square(errors[:, :2]), root_mean_square(wrap_all(errors[:, 2:]))


def _row(of: MrclamRun) -> list[str]:
    return [
        of.task.name, of.task.filter, 'used' if of.task.robots_seen else 'not used',
        f'{of.position:.3f}', f'{of.fitted_position:.3f}', f'{max(of.of_robots.values()):.3f}',
        f'{of.heading:.4f}', f'{of.fitted_heading:.4f}', f'{of.nees:.2f}', f'{of.nis:.2f}',
        f'{of.landmarks} of {of.true_landmarks}', f'{of.landmark_rmse:.3f}',
        f'{100.0 * min(of.in_map.values()):.1f}', f'{of.seconds:.0f}']
