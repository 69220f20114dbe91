# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
MRCLAM sets, up to five real robots: each filter with and without robot-to-robot observations.

All robots but the anchor have unknown starts. Ground truth is motion capture; times and robots
without it are not evaluated. Least squares has the same measurements and noise, later ones too.
"""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
import time
from typing import Any, NamedTuple

import numpy as np

from fej_slam_ros.core.consistency import nees_per_dof, root_mean_square, total_nis_per_dof
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import (
    Array, compose, Flags, Indices, inverse, pose_difference, pose_rotation, poses_at, rigid_fit,
    transform, transform_poses)
from fej_slam_ros.core.records import Record
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.datasets.mrclam import conversion, files, run_settings
from fej_slam_ros.datasets.mrclam.conversion import robot_name
from fej_slam_ros.datasets.mrclam.conversion_options import ConversionOptions
from fej_slam_ros.datasets.mrclam.files import MrclamSet
from fej_slam_ros.datasets.mrclam.noise import best_options
from fej_slam_ros.datasets.series import Series
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.real_data.causal_least_squares import (
    causal_least_squares, CausalErrors)
from fej_slam_ros.tables import markdown_table

MRCLAM_FILTERS = ('standard', 'fej', 'invariant')
#: Name of the smoother's solution among the filters.
LEAST_SQUARES = 'least squares'
CAUSAL_NOTES = """\
The newest pose of each robot once a minute: of least squares over all until then, which is what a
filter can reach with the same measurements and noise, and of `fej` at the same stamps."""
CAUSAL_TITLES = (
    'set', 'robot-to-robot observations', 'poses', 'least squares [m]', 'fej [m]')
MRCLAM_NOTES = """\
Robots run from the commands, scaled, delayed and with the noise that `convert mrclam` measures;
all but the anchor have unknown starts. Position and heading errors are root mean squares over all
true poses of all robots, as estimated (in the frame of the anchor's given start) and after one
rigid fit of all robots; NEES/3 and NIS/2 are means. Landmarks are compared after the same fit.
Robots without ground truth take part and are not evaluated. Least squares is that of `smooth`; it
knows the later measurements too. Dead reckoning starts each robot at its true pose."""
MRCLAM_TITLES = (
    'set', 'filter', 'robot-to-robot observations', 'position [m]', 'after a fit [m]',
    'worst robot [m]', 'heading [rad]', 'after a fit [rad]', 'NEES/3', 'NIS/2', 'landmarks',
    'landmarks [m]', 'in map, least [%]', 'time [s]')


@dataclass(frozen=True)
class MrclamTask:
    """
    A run: folder of the set, filter, and whether robot-to-robot observations are used.

    The filter may be LEAST_SQUARES.

    """

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
    nees: float  #: Mean, divided by 3
    #: Number of landmarks in the map, and in the data set.
    landmarks: int
    true_landmarks: int
    landmark_rmse: float  #: RMSE of the landmarks after the same fit [m]
    in_map: Mapping[str, float]  #: Fraction of each robot's poses that are in the common map
    seconds: float  #: Processing time
    #: Of a filter: mean NIS, divided by 2, and position RMSE of odometry alone, of each robot [m].
    nis: float | None = None
    dead_reckoning: Mapping[str, float] = field(default_factory=dict)
    causal: CausalErrors | None = None  #: Of least squares


@dataclass(frozen=True, slots=True, eq=False)
class MrclamErrors:
    """A robot at the stamps with ground truth."""

    #: (n, 3) arrays, the poses in ``map``.
    estimated: Array
    true: Array
    nees: Array  #: (n,) array, NEES/3
    in_map: float  #: Fraction of all its steps that are in ``map``


class Trajectory(NamedTuple):
    """The estimates of a robot."""

    stamps: Indices  #: (k,) array [ns]
    poses: Array  #: (k, 3) array
    P: Array  #: (k, 3, 3) array, their covariances
    in_map: Flags  #: (k,) array, whether the pose is in ``map``


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
        for name in (*MRCLAM_FILTERS, LEAST_SQUARES)]


def run(task: MrclamTask) -> MrclamRun:
    """Run a filter on a set, which must have ground truth and observations, and evaluate it."""
    data, options = _evaluable(task.folder)
    options = replace(options, robot_observations=task.robots_seen)
    data = run_settings.with_known_anchor(data, options)
    settings = run_settings.settings(data, options)
    counts: dict[int, Counter[str]] = {robot: Counter() for robot in data.logs}
    records = conversion.records(data, options, counts)
    if task.filter == LEAST_SQUARES:
        return _smoothed(task, data, settings, records)
    return _filtered(task, data, replace(settings, filter=task.filter), records)


def markdown(runs: Sequence[MrclamRun]) -> str:
    """Return the runs as a page."""
    first_of_set = {result.task.name: result for result in reversed(runs)}
    drifts = [
        f'{name}: {", ".join(f"{robot} {e:.2f}" for robot, e in result.dead_reckoning.items())}'
        for name, result in sorted(first_of_set.items()) if result.dead_reckoning]
    return '\n\n'.join([
        '# MRCLAM', MRCLAM_NOTES, markdown_table(MRCLAM_TITLES, map(_row, runs), (0, 1, 2)),
        CAUSAL_NOTES, markdown_table(CAUSAL_TITLES, [
            _causal_row(result.task, result.causal) for result in runs
            if result.causal and result.causal.poses],
            (0, 1)),
        f'Dead reckoning, position RMSE [m]: {"; ".join(drifts)}.']) + '\n'


def summary(runs: Sequence[MrclamRun]) -> list[dict[str, Any]]:
    """Return the runs for a JSON file."""
    return [asdict(result) | {'task': {
        'set': result.task.name, 'filter': result.task.filter,
        'robots_seen': result.task.robots_seen}}
        for result in runs]


def _filtered(
    task: MrclamTask, data: MrclamSet, settings: Settings, records: Iterable[Record]
) -> MrclamRun:
    estimator, begin = Estimator(settings), time.perf_counter()
    estimates: defaultdict[str, list[PoseEstimate]] = defaultdict(list)
    odometry: defaultdict[str, list[Array]] = defaultdict(list)
    for result in estimator.run(records):
        for estimate in result.poses:
            estimates[estimate.robot].append(estimate)
            odometry[estimate.robot].append(result.odometry[estimate.robot])
    seconds = time.perf_counter() - begin
    monitors = estimator.innovations.nis.values()
    if not any(monitor.dof for monitor in monitors):
        raise UserError(_nothing_observed_twice(task))
    trajectories = {name: _trajectory(poses) for name, poses in estimates.items()}
    return replace(
        _evaluated(
            task, data, trajectories,
            {landmark.id: landmark.position for landmark in estimator.landmarks()}, seconds),
        nis=total_nis_per_dof(monitors), dead_reckoning={
            name: _drift(trajectories[name].stamps, np.array(odometry[name]), true)
            for name, true in _truth(data, trajectories).items()})


def _smoothed(
    task: MrclamTask, data: MrclamSet, settings: Settings, records: Iterable[Record]
) -> MrclamRun:
    begin = time.perf_counter()
    team, causal = causal_least_squares(settings, records)
    seconds = time.perf_counter() - begin
    of_anchor = next(
        (solved for solved in team.solution.maps if settings.anchor in solved.trajectories), None)
    if of_anchor is None:
        raise UserError(_nothing_observed_twice(task))
    # As long as no other robot has joined, a map has the frame of its robot's first pose.
    start = np.zeros(3) if of_anchor.frame == MAP else np.array(settings.anchor_pose)
    C = pose_rotation(start[2])
    trajectories = {
        name: Trajectory(
            np.array(trajectory.stamps), transform_poses(start, trajectory.poses()),
            C @ trajectory.covariances() @ C.T,
            np.full(len(trajectory.stamps), name in of_anchor.trajectories))
        for name, trajectory in team.trajectories.items()}
    landmarks = {
        id_: point for ((_, id_), *_), point in zip(
            of_anchor.landmarks, transform(start, of_anchor.points))}
    return replace(_evaluated(task, data, trajectories, landmarks, seconds), causal=causal)


def _trajectory(estimates: Sequence[PoseEstimate]) -> Trajectory:
    return Trajectory(
        np.array([estimate.stamp for estimate in estimates]),
        np.array([estimate.pose for estimate in estimates]),
        np.array([estimate.P for estimate in estimates]),
        np.array([estimate.frame == MAP for estimate in estimates]))


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


def _truth(data: MrclamSet, trajectories: Mapping[str, Trajectory]) -> dict[str, Series]:
    """Return the true poses between the first and last estimate of each robot that has some."""
    between = {
        name: log.truth.between(trajectories[name].stamps[0], trajectories[name].stamps[-1])
        for robot, log in data.logs.items() for name in [robot_name(robot)]}
    return {name: truth for name, truth in between.items() if len(truth)}


def _errors(trajectory: Trajectory, truth: Series) -> MrclamErrors:
    """Return a robot's errors at stamps with ground truth between its first and last estimate."""
    after = np.searchsorted(trajectory.stamps, truth.stamps)
    used = trajectory.in_map[after] & trajectory.in_map[(after - 1).clip(0)]
    estimated = poses_at(truth.stamps, trajectory.stamps, trajectory.poses)[used]
    true = truth.rows[used]
    return MrclamErrors(
        estimated, true, nees_per_dof(pose_difference(estimated, true), trajectory.P[after][used]),
        float(trajectory.in_map.mean()))


def _drift(stamps: Indices, odometry: Array, truth: Series) -> float:
    """Return the position RMSE [m] of odometry that begins at the first true pose."""
    poses = poses_at(truth.stamps, stamps, odometry)
    begin = compose(truth.rows[0], inverse(poses[0]))
    return root_mean_square((transform_poses(begin, poses) - truth.rows)[:, :2])


def _evaluated(
    task: MrclamTask, data: MrclamSet, trajectories: Mapping[str, Trajectory],
    landmarks: Mapping[int, Array], seconds: float,
) -> MrclamRun:
    errors = {
        name: _errors(trajectories[name], truth)
        for name, truth in _truth(data, trajectories).items()}
    points = [
        (point, data.landmarks[id_]) for id_, point in landmarks.items() if id_ in data.landmarks]
    if not points:
        raise UserError(_nothing_observed_twice(task))
    mapped, true_points = map(np.array, zip(*points))
    estimated = np.vstack([of_robot.estimated for of_robot in errors.values()])
    true = np.vstack([of_robot.true for of_robot in errors.values()])
    fit = rigid_fit(estimated[:, :2], true[:, :2])
    return MrclamRun(
        task, *_rmse(estimated, true), *_rmse(transform_poses(fit, estimated), true),
        {name: _rmse(transform_poses(fit, of_robot.estimated), of_robot.true)[0]
         for name, of_robot in errors.items() if len(of_robot.estimated)},
        float(np.concatenate([of_robot.nees for of_robot in errors.values()]).mean()),
        len(landmarks), len(data.landmarks),
        root_mean_square(transform(fit, mapped) - true_points),
        {name: of_robot.in_map for name, of_robot in errors.items()}, seconds)


def _nothing_observed_twice(task: MrclamTask) -> str:
    return (
        f'{task.folder} has no known landmark that is observed twice to evaluate with: take'
        ' another set, or convert and replay it')


def _rmse(estimated: Array, true: Array) -> tuple[float, float]:
    """Return the RMSE of positions [m] and headings [rad] of poses (n, 3)."""
    errors = pose_difference(estimated, true)
    return root_mean_square(errors[:, :2]), root_mean_square(errors[:, 2:])


def _row(result: MrclamRun) -> list[str]:
    return [
        result.task.name, result.task.filter, 'used' if result.task.robots_seen else 'not used',
        f'{result.position:.3f}', f'{result.fitted_position:.3f}',
        f'{max(result.of_robots.values()):.3f}',
        f'{result.heading:.4f}', f'{result.fitted_heading:.4f}', f'{result.nees:.2f}',
        '' if result.nis is None else f'{result.nis:.2f}',
        f'{result.landmarks} of {result.true_landmarks}', f'{result.landmark_rmse:.3f}',
        f'{100.0 * min(result.in_map.values()):.1f}', f'{result.seconds:.0f}']


def _causal_row(task: MrclamTask, causal: CausalErrors) -> list[str]:
    return [
        task.name, 'used' if task.robots_seen else 'not used', str(causal.poses),
        f'{causal.least_squares:.3f}', f'{causal.filter:.3f}']
