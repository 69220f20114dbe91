# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Victoria Park, section 4.2 of [Liu]: the filters beside least squares over all that was measured.

One car's log is made two robots. Nobody knows the truth, so two solutions stand for it: least
squares over both robots with the noise that the filters assume, and least squares over the whole
log of the one car without weights, which is X_GNI, the truth in [Liu]. The ideal filter is
linearised at the former: that is no truth either.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import accumulate, chain
from pathlib import Path

import numpy as np

from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array, compose, Indices, transform, wrap_all
from fej_slam_ros.core.joining.initial_alignment import closed_form, InitialAlignmentError
from fej_slam_ros.core.records import TrueLandmarks, TruePose
from fej_slam_ros.core.smoothing.least_squares import (
    LandmarkFactors, OdometryFactors, Problem, solve, Values)
from fej_slam_ros.datasets.liu import batch_solution
from fej_slam_ros.datasets.liu.batch_solution import XGni
from fej_slam_ros.datasets.victoria_park import associated_log as park
from fej_slam_ros.datasets.victoria_park.associated_log import Log, Team
from fej_slam_ros.errors import UserError
from fej_slam_ros.experiments.liu.metrics import root_mean_square

#: Names in files, with their titles.
FILTERS = {'standard': 'standard', 'fej': 'FEJ', 'invariant': 'invariant', 'ideal': 'ideal'}
REFERENCES = {
    'two_robot_batch': 'two-robot batch', 'one_robot_batch': 'one-robot batch (X_GNI)',
    'until_then': 'least squares until then'}

#: The first step of each robot that counts: where r1 sets out is given.
FIRST_STEPS = {'r1': 1, 'r2': 0}

#: Standard deviations [m] of an observation that the filters assume: that of [Liu], and twice that.
OBSERVATION_SIGMAS = (0.075, 0.15)

#: What least squares knows right after a step is told of every so many.
EVERY = 50

#: How many solutions there are.
SOLUTIONS = 3 + len(OBSERVATION_SIGMAS) * len(FILTERS)

#: RMSE by reference, filter or bound, and entry.
Rmse = Mapping[str, Mapping[str, Mapping[str, float]]]


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """
    What a method makes of the log, in the frame ``map``.

    Attributes
    ----------
    poses : (K + 1, 3) array of each robot, its pose after every step [m, m, rad]
    points : (2,) position [m] of each landmark by its id, after the last step

    """

    poses: Mapping[str, Array]
    points: Mapping[int, Array]


@dataclass(frozen=True, slots=True, eq=False)
class Batch:
    """A solution of least squares, its cost, and how many unknowns and iterations it took."""

    estimate: Estimate
    cost: float
    unknowns: int
    iterations: int


@dataclass(frozen=True, slots=True)
class Difference:
    """Largest distance [m] of two poses or landmarks and largest turn [rad] between two poses."""

    position: float
    heading: float


@dataclass(frozen=True, slots=True, eq=False)
class VictoriaPark:
    """
    The whole experiment.

    Attributes
    ----------
    two_robots : least squares with the filters' weights, where the anchor sets out being given
    one_robot : least squares without weights over the whole log, from the origin
    filters : what each filter makes of the two robots with the noise of [Liu]
    rmse : how far the filters are from both, by the standard deviation of an observation [m]; with the
        noise of [Liu] also from what least squares knew at every 50th step
    bounds : how far least squares over both robots is from one_robot, until each step and in all
    batch_solution : how far one_robot is from the authors' file, or None where that is not in the folder

    """

    two_robots: Batch
    one_robot: Batch
    filters: Mapping[str, Estimate]
    rmse: Mapping[float, Rmse]
    bounds: Mapping[str, Mapping[str, float]]
    batch_solution: Difference | None

    def batches(self) -> dict[str, Batch]:
        """Return both solutions of least squares by name."""
        return {'two_robot_batch': self.two_robots, 'one_robot_batch': self.one_robot}

    def solutions(self) -> dict[str, Estimate]:
        """Return all estimates by name."""
        return {**{name: of.estimate for name, of in self.batches().items()}, **self.filters}


def reproduce(
    folder: Path, progress: Callable[[str], None] = lambda doing: None
) -> VictoriaPark:
    """
    Compute everything from the log in a folder.

    Parameters
    ----------
    folder : holds a file that `datasets.victoria_park` reads, and maybe X_GNI.mat
    progress : is told what will be done next

    Raises
    ------
    UserError
        There is no such file or folder, or a file is damaged or of something else.

    """
    path = park.find(folder)
    log = park.read(path)
    stored = _stored(folder, log)
    team, car = park.TEAMS[2], park.TEAMS[1]
    logs = park.divide(log, team)
    try:
        progress('least squares over two robots')
        start = dead_reckoning(logs, first_poses(logs, team))
        two_robots = least_squares(logs, start, park.Q, park.R)
        progress('least squares over the whole log')
        one_robot = unweighted(park.divide(log, car), car)
    except ArithmeticError as error:
        raise UserError(f'{path}: {error}; take the log of Victoria Park') from error
    progress('least squares until each step')
    hindsight = two_robots.estimate
    known = until_then(logs, hindsight)
    filters = _all_filtered(logs, team, hindsight, progress)
    whole = _as_team(one_robot.estimate, logs, team)
    references = {'two_robot_batch': hindsight, 'one_robot_batch': whole}
    table = {
        sigma: {name: _rmse_of_each(by_name, truth) for name, truth in references.items()}
        for sigma, by_name in filters.items()}
    of_liu = filters[OBSERVATION_SIGMAS[0]]
    table[OBSERVATION_SIGMAS[0]]['until_then'] = _rmse_of_each(
        {name: _thinned(estimate) for name, estimate in of_liu.items()}, known)
    bounds = {
        'until_then': rmse(known, _thinned(whole)), 'two_robot_batch': rmse(hindsight, whole)}
    difference = None if stored is None else _difference(one_robot.estimate, stored)
    return VictoriaPark(two_robots, one_robot, of_liu, table, bounds, difference)


def _all_filtered(
    logs: Mapping[str, Log], team: Team, truth: Estimate, progress: Callable[[str], None]
) -> dict[float, dict[str, Estimate]]:
    """Return what each filter makes of the logs with observations of each noise."""
    found: dict[float, dict[str, Estimate]] = {}
    for sigma in OBSERVATION_SIGMAS:
        measured, found[sigma] = with_observation_noise(logs, sigma), {}
        for name, title in FILTERS.items():
            progress(f'{title} filter over two robots, observations of {sigma} m')
            found[sigma][name] = filtered(measured, team, name, truth)
    return found


def first_poses(logs: Mapping[str, Log], team: Team) -> dict[str, Array]:
    """
    Return where the robots set out: the first is told, the others see what it sees.

    Raises
    ------
    AlignmentError
        If what they see from there does not tell where all of them are.

    """
    seen = {robot: [(('', s.id), s) for s in log.observations[0]] for robot, log in logs.items()}
    poses, _ = closed_form({next(iter(logs)): np.array(team.anchor_pose)}, {}, seen)
    if poses.keys() != logs.keys():
        raise InitialAlignmentError('the robots share too few landmarks where they set out')
    return poses


def dead_reckoning(logs: Mapping[str, Log], first: Mapping[str, Array]) -> Estimate:
    """Return where odometry alone puts the robots, and landmarks where they are first seen."""
    poses = {
        robot: np.array(list(accumulate(log.increments, compose, initial=first[robot])))
        for robot, log in logs.items()}
    points: dict[int, Array] = {}
    for robot, log in logs.items():
        for pose, seen in zip(poses[robot], log.observations):
            new = [s for s in seen if s.id not in points]
            points.update({s.id: transform(pose, s.z) for s in new})
    return Estimate(poses, points)


def least_squares(logs: Mapping[str, Log], start: Estimate, Q: Array, R: Array) -> Batch:
    """Return the minimum near a start, where increments have covariance Q and observations R."""
    solution = solve(*as_problem(logs, start, Q, R))
    poses = np.split(solution.values.poses, _ends(logs)[:-1])
    estimate = Estimate(dict(zip(logs, poses)), dict(zip(start.points, solution.values.points)))
    return Batch(estimate, solution.cost, solution.unknowns, solution.iterations)


def as_problem(
    logs: Mapping[str, Log], start: Estimate, Q: Array, R: Array
) -> tuple[Problem, Values]:
    """Return problem and start with poses robot by robot, landmarks in the order of the start."""
    ends, numbers = _ends(logs), {id_: number for number, id_ in enumerate(start.points)}
    begin = np.delete(np.arange(ends[-1]), ends - 1)
    u = np.concatenate([log.increments for log in logs.values()])
    scans = enumerate(chain.from_iterable(log.observations for log in logs.values()))
    pose, landmark, z = map(np.array, zip(*(
        (number, numbers[s.id], s.z) for number, scan in scans for s in scan)))
    values = Values(
        np.concatenate([start.poses[robot] for robot in logs]), np.array([*start.points.values()]))
    increments = OdometryFactors(begin, begin + 1, u, Q)
    return Problem(increments, LandmarkFactors(pose, landmark, z, R)), values


def unweighted(logs: Mapping[str, Log], team: Team) -> Batch:
    """
    Return least squares without weights, from the trajectory and the map of the FEJ filter.

    Over the whole log dead reckoning strays by 300 m, too far to trust the minimum that is found
    from there. The filter has closed the loops: it is within 6 m of the solution, and the cost
    falls at every iteration.

    """
    return least_squares(logs, filtered(logs, team, 'fej'), np.eye(3), np.eye(2))


def until_then(logs: Mapping[str, Log], hindsight: Estimate) -> Estimate:
    """
    Return what least squares over all that was measured until then knows right after a step.

    No filter can be expected to know more. Poses are those of every 50th step, the map is the last
    one.

    Parameters
    ----------
    logs : what the robots measured
    hindsight : least squares over all of it, near which the others are sought

    """
    poses: dict[str, list[Array]] = {robot: [] for robot in logs}
    for k in range(0, max(len(log.observations) for log in logs.values()), EVERY):
        past = {
            robot: Log(log.increments[:k], log.observations[:k + 1]) for robot, log in logs.items()}
        seen = {s.id for log in past.values() for scan in log.observations for s in scan}
        start = Estimate(
            {robot: x[:k + 1] for robot, x in hindsight.poses.items()},
            {id_: point for id_, point in hindsight.points.items() if id_ in seen})
        known = least_squares(past, start, park.Q, park.R).estimate
        for robot, x in known.poses.items():
            poses[robot].append(x[-1])
    return Estimate({robot: np.array(x) for robot, x in poses.items()}, hindsight.points)


def with_observation_noise(logs: Mapping[str, Log], sigma: float) -> dict[str, Log]:
    """Return the logs with another standard deviation [m] of both coordinates of an observation."""
    R = sigma**2 * np.eye(2)
    return {
        robot: replace(log, observations=[
            tuple(replace(observation, R=R) for observation in scan) for scan in log.observations])
        for robot, log in logs.items()}


def filtered(
    logs: Mapping[str, Log], team: Team, name: str, truth: Estimate | None = None
) -> Estimate:
    """
    Return the poses that a filter gives after each step, and its map after the last.

    Parameters
    ----------
    logs, team : what the robots measured, and where they set out
    name : of the filter
    truth : where the ideal filter is linearised; no other needs it

    """
    estimator = Estimator(replace(park.settings(team), filter=name))
    for told in () if truth is None else _as_truth(truth):
        estimator.add(told)
    for record in park.records(logs):
        estimator.add(record)
    poses: dict[str, list[Array]] = {robot: [] for robot in logs}
    for step in estimator.close():
        for estimate in step.poses:
            poses[estimate.robot].append(estimate.pose)
    return Estimate(
        {robot: np.array(of_robot) for robot, of_robot in poses.items()},
        {landmark.id: landmark.position for landmark in estimator.landmarks()})


def rmse(estimate: Estimate, reference: Estimate) -> dict[str, float]:
    """Return the entries: one root of the mean over all steps that count, or all landmarks."""
    entries = {}
    for robot, first in FIRST_STEPS.items():
        error = estimate.poses[robot][first:] - reference.poses[robot][first:]
        entries[f'{robot}_pos'] = root_mean_square(error[:, :2])
        entries[f'{robot}_head'] = root_mean_square(wrap_all(error[:, 2:]))
    errors = [point - reference.points[id_] for id_, point in estimate.points.items()]
    return {**entries, 'f_pos': root_mean_square(np.array(errors))}


def _rmse_of_each(
    estimates: Mapping[str, Estimate], reference: Estimate
) -> dict[str, dict[str, float]]:
    return {name: rmse(estimate, reference) for name, estimate in estimates.items()}


def _stored(folder: Path, log: Log) -> XGni | None:
    """Return the authors' solution of the log, or None where it is not in the folder."""
    path = batch_solution.find(folder)
    if path is None:
        return None
    stored = batch_solution.read(path)
    ids = {s.id for seen in log.observations for s in seen}
    if len(stored.poses) > len(log.observations) or stored.points.keys() != ids:
        raise UserError(f'{path} is the solution of another log; fetch the file again')
    return stored


def _as_truth(estimate: Estimate) -> Iterator[TruePose | TrueLandmarks]:
    yield TrueLandmarks(estimate.points)
    for robot, poses in estimate.poses.items():
        for k, pose in enumerate(poses):
            yield TruePose(robot, park.FIRST_STAMP + k * park.PERIOD, pose)


def _thinned(estimate: Estimate) -> Estimate:
    """Return the estimate with the poses of every so many steps only."""
    return replace(estimate, poses={robot: x[::EVERY] for robot, x in estimate.poses.items()})


def _ends(logs: Mapping[str, Log]) -> Indices:
    """Return for each robot how many poses it and those before it have."""
    return np.cumsum([len(log.observations) for log in logs.values()])


def _as_team(estimate: Estimate, logs: Mapping[str, Log], team: Team) -> Estimate:
    """Return the one car's estimate as that of the robots that it stands for."""
    (car,) = estimate.poses.values()
    return Estimate(
        {robot: car[team.poses[robot][0]:][:len(log.observations)] for robot, log in logs.items()},
        estimate.points)


def _difference(estimate: Estimate, stored: XGni) -> Difference:
    """Return how far the one car's estimate is from the stored one, which lacks its last pose."""
    (car,) = estimate.poses.values()
    poses = car[:len(stored.poses)] - stored.poses
    points = np.array([point - stored.points[id_] for id_, point in estimate.points.items()])
    return Difference(
        float(np.linalg.norm(np.concatenate([poses[:, :2], points]), axis=1).max()),
        float(np.abs(wrap_all(poses[:, 2])).max()))
