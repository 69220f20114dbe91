# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Victoria Park, section 4.2 of [Liu]: the filters compared with batch least squares.

The log of one car is divided into two robots. There is no ground truth; two batch solutions stand
for it: least squares over both robots with the noise that the filters assume, and unweighted least
squares over the whole log of the one car, X_GNI, the ground truth in [Liu]. The ideal filter is
linearised at the former.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import accumulate, chain
from pathlib import Path

import numpy as np

from fej_slam_ros.core.consistency import root_mean_square
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array, compose, Indices, pose_difference, transform
from fej_slam_ros.core.joining.initial_alignment import closed_form, InitialAlignmentError
from fej_slam_ros.core.records import TrueLandmarks, TruePose
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, OdometryFactors, Values
from fej_slam_ros.core.smoothing.least_squares import solve
from fej_slam_ros.core.smoothing.problem import Problem
from fej_slam_ros.datasets.liu import batch_solution
from fej_slam_ros.datasets.liu.batch_solution import XGni
from fej_slam_ros.datasets.victoria_park import associated_log as park
from fej_slam_ros.datasets.victoria_park.associated_log import AssociatedLog, CarTeam
from fej_slam_ros.errors import UserError

#: Names in files, with their titles.
PARK_FILTERS = {'standard': 'standard', 'fej': 'FEJ', 'invariant': 'invariant', 'ideal': 'ideal'}
REFERENCES = {
    'two_robot_batch': 'two-robot batch', 'one_robot_batch': 'one-robot batch (X_GNI)',
    'until_then': 'causal least squares'}
#: First step of each robot that is evaluated: the start of r1 is given.
FIRST_STEPS = {'r1': 1, 'r2': 0}
#: Standard deviations [m] of an observation that the filters assume: that of [Liu], and twice it.
OBSERVATION_SIGMAS = (0.075, 0.15)
#: Steps between two causal least-squares solutions.
CAUSAL_STRIDE = 50
#: Number of solutions that `reproduce` computes.
SOLUTIONS = 3 + len(OBSERVATION_SIGMAS) * len(PARK_FILTERS)
#: Measurements of each robot.
TeamLogs = Mapping[str, AssociatedLog]
#: RMSE by reference, filter or bound, and entry.
Rmse = Mapping[str, Mapping[str, Mapping[str, float]]]


@dataclass(frozen=True, slots=True, eq=False)
class ParkEstimate:
    """Solution of one method in the frame ``map``."""

    #: (K + 1, 3) array of each robot, its pose after every step [m, m, rad].
    poses: Mapping[str, Array]
    #: (2,) position [m] of each landmark by its ID, after the last step.
    points: Mapping[int, Array]


@dataclass(frozen=True, slots=True, eq=False)
class BatchSolution:
    """A least-squares solution, its cost, and the number of unknowns and iterations."""

    estimate: ParkEstimate
    cost: float
    unknowns: int
    iterations: int


@dataclass(frozen=True, slots=True)
class MaxDifference:
    """Largest distance [m] of two poses or landmarks and largest angle [rad] of two headings."""

    position: float
    heading: float


@dataclass(frozen=True, slots=True, eq=False)
class VictoriaPark:
    """Results of the experiment."""

    #: Least squares with the filters' weights, the start of the anchor being given.
    two_robots: BatchSolution
    one_robot: BatchSolution  #: Unweighted least squares over the whole log, from the origin
    filters: Mapping[str, ParkEstimate]  #: Estimate of each filter with the noise of [Liu]
    #: Of the filters against both, by the standard deviation of an observation [m]; with the noise
    #: of [Liu] also against causal least squares at every 50th step.
    rmse: Mapping[float, Rmse]
    #: RMSE of causal and of two-robot least squares against one_robot.
    bounds: Mapping[str, Mapping[str, float]]
    #: Difference of one_robot from the authors' file, None if the folder does not have it.
    x_gni: MaxDifference | None

    def batches(self) -> dict[str, BatchSolution]:
        """Return both least-squares solutions by name."""
        return {'two_robot_batch': self.two_robots, 'one_robot_batch': self.one_robot}

    def solutions(self) -> dict[str, ParkEstimate]:
        """Return all estimates by name."""
        return {
            **{name: batch.estimate for name, batch in self.batches().items()}, **self.filters}


def reproduce(
    folder: Path, progress: Callable[[str], None] = lambda solution: None
) -> VictoriaPark:
    """
    Compute all solutions from the log in a folder, which may also hold X_GNI.mat.

    The name of each solution is passed to `progress` before it is computed.
    """
    path = park.find(folder)
    log = park.read(path)
    stored = _stored(folder, log)
    team, car = park.CAR_TEAMS[2], park.CAR_TEAMS[1]
    logs = park.divide(log, team)
    try:
        progress('least squares over two robots')
        initial = dead_reckoning(logs, first_poses(logs, team))
        two_robots = least_squares(logs, initial)
        progress('least squares over the whole log')
        one_robot = unweighted(park.divide(log, car), car)
    except ArithmeticError as error:
        raise UserError(f'{path}: {error}; take the log of Victoria Park') from error
    progress('causal least squares')
    batch = two_robots.estimate
    causal = causal_least_squares(logs, batch)
    filters = _all_filtered(logs, team, batch, progress)
    whole = _as_team(one_robot.estimate, logs, team)
    references = {'two_robot_batch': batch, 'one_robot_batch': whole}
    table = {
        sigma: {name: _rmse_of_each(by_name, truth) for name, truth in references.items()}
        for sigma, by_name in filters.items()}
    of_liu = filters[OBSERVATION_SIGMAS[0]]
    table[OBSERVATION_SIGMAS[0]]['until_then'] = _rmse_of_each(
        {name: _thinned(estimate) for name, estimate in of_liu.items()}, causal)
    bounds = {'until_then': rmse(causal, _thinned(whole)), 'two_robot_batch': rmse(batch, whole)}
    difference = None if stored is None else _difference(one_robot.estimate, stored)
    return VictoriaPark(two_robots, one_robot, of_liu, table, bounds, difference)


def _all_filtered(
    logs: TeamLogs, team: CarTeam, truth: ParkEstimate, progress: Callable[[str], None]
) -> dict[float, dict[str, ParkEstimate]]:
    """Return the estimate of each filter by the standard deviation of an observation."""
    estimates: dict[float, dict[str, ParkEstimate]] = {}
    for sigma in OBSERVATION_SIGMAS:
        noisy, estimates[sigma] = with_observation_noise(logs, sigma), {}
        for name, title in PARK_FILTERS.items():
            progress(f'{title} filter over two robots, observations of {sigma} m')
            estimates[sigma][name] = filtered(noisy, team, name, truth)
    return estimates


def first_poses(logs: TeamLogs, team: CarTeam) -> dict[str, Array]:
    """
    Return the start poses: the first is given, the others follow from shared landmarks.

    If they do not determine all of them, raise an `InitialAlignmentError`.
    """
    observed = {
        robot: [(('', s.id), s) for s in log.observations[0]] for robot, log in logs.items()}
    poses, _ = closed_form({next(iter(logs)): np.array(team.anchor_pose)}, {}, observed)
    if poses.keys() != logs.keys():
        raise InitialAlignmentError('the robots share too few landmarks at their first poses')
    return poses


def dead_reckoning(logs: TeamLogs, first: Mapping[str, Array]) -> ParkEstimate:
    """Return the poses by odometry alone, and the landmarks by their first observations."""
    poses = {
        robot: np.array(list(accumulate(log.increments, compose, initial=first[robot])))
        for robot, log in logs.items()}
    points: dict[int, Array] = {}
    for robot, log in logs.items():
        for pose, observations in zip(poses[robot], log.observations):
            new = [s for s in observations if s.id not in points]
            points.update({s.id: transform(pose, s.z) for s in new})
    return ParkEstimate(poses, points)


def least_squares(
    logs: TeamLogs, initial: ParkEstimate, Q: Array = park.ODOMETRY_Q,
    R: Array = park.OBSERVATION_R,
) -> BatchSolution:
    """Return the minimum near an estimate; increments have covariance Q and observations R."""
    solution = solve(*as_problem(logs, initial, Q, R))
    poses = np.split(solution.values.poses, _ends(logs)[:-1])
    estimate = ParkEstimate(
        dict(zip(logs, poses)), dict(zip(initial.points, solution.values.points)))
    return BatchSolution(estimate, solution.cost, solution.unknowns, solution.iterations)


def as_problem(
    logs: TeamLogs, initial: ParkEstimate, Q: Array = park.ODOMETRY_Q,
    R: Array = park.OBSERVATION_R,
) -> tuple[Problem, Values]:
    """Return the problem and its initial values: poses robot by robot, landmarks in order."""
    ends, index_of = _ends(logs), {id_: index for index, id_ in enumerate(initial.points)}
    begin = np.delete(np.arange(ends[-1]), ends - 1)
    u = np.concatenate([log.increments for log in logs.values()])
    scans = enumerate(chain.from_iterable(log.observations for log in logs.values()))
    pose, landmark, z = map(np.array, zip(*(
        (k, index_of[s.id], s.z) for k, scan in scans for s in scan)))
    values = Values(
        np.concatenate([initial.poses[robot] for robot in logs]),
        np.array([*initial.points.values()]))
    increments = OdometryFactors(begin, begin + 1, u, Q)
    return Problem(increments, LandmarkFactors(pose, landmark, z, R)), values


def unweighted(logs: TeamLogs, team: CarTeam) -> BatchSolution:
    """
    Return least squares without weights, from the estimate of the FEJ filter.

    Over the whole log dead reckoning drifts by 300 m, too far for a reliable initial value. The
    filter has closed the loops: it is within 6 m of the solution, and the cost falls at every
    iteration.
    """
    return least_squares(logs, filtered(logs, team, 'fej'), np.eye(3), np.eye(2))


def causal_least_squares(logs: TeamLogs, batch: ParkEstimate) -> ParkEstimate:
    """
    Return the last poses of least squares over all measurements up to every 50th step.

    No filter can be expected to be better. The batch solution provides initial values and the map.
    """
    poses: dict[str, list[Array]] = {robot: [] for robot in logs}
    for k in range(0, max(len(log.observations) for log in logs.values()), CAUSAL_STRIDE):
        past = {
            robot: AssociatedLog(log.increments[:k], log.observations[:k + 1])
            for robot, log in logs.items()}
        observed = {s.id for log in past.values() for scan in log.observations for s in scan}
        initial = ParkEstimate(
            {robot: x[:k + 1] for robot, x in batch.poses.items()},
            {id_: point for id_, point in batch.points.items() if id_ in observed})
        solution = least_squares(past, initial).estimate
        for robot, x in solution.poses.items():
            poses[robot].append(x[-1])
    return ParkEstimate({robot: np.array(x) for robot, x in poses.items()}, batch.points)


def with_observation_noise(logs: TeamLogs, sigma: float) -> dict[str, AssociatedLog]:
    """Return the logs with another standard deviation [m] of both coordinates of observations."""
    R = sigma**2 * np.eye(2)
    return {
        robot: replace(log, observations=[
            tuple(replace(observation, R=R) for observation in scan) for scan in log.observations])
        for robot, log in logs.items()}


def filtered(
    logs: TeamLogs, team: CarTeam, name: str, truth: ParkEstimate | None = None
) -> ParkEstimate:
    """
    Return the poses of a filter after each step, and its map after the last.

    The ideal filter is linearised at `truth`; no other needs it.
    """
    estimator = Estimator(replace(park.settings(team), filter=name))
    for record in chain(() if truth is None else _as_truth(truth), park.records(logs)):
        estimator.add(record)
    poses: dict[str, list[Array]] = {robot: [] for robot in logs}
    for step in estimator.close():
        for estimate in step.poses:
            poses[estimate.robot].append(estimate.pose)
    return ParkEstimate(
        {robot: np.array(of_robot) for robot, of_robot in poses.items()},
        {landmark.id: landmark.position for landmark in estimator.landmarks()})


def rmse(estimate: ParkEstimate, reference: ParkEstimate) -> dict[str, float]:
    """Return the entries: root mean square over all evaluated steps, or all landmarks."""
    entries = {}
    for robot, first in FIRST_STEPS.items():
        error = pose_difference(estimate.poses[robot][first:], reference.poses[robot][first:])
        entries[f'{robot}_pos'] = root_mean_square(error[:, :2])
        entries[f'{robot}_head'] = root_mean_square(error[:, 2:])
    errors = [point - reference.points[id_] for id_, point in estimate.points.items()]
    return {**entries, 'f_pos': root_mean_square(np.array(errors))}


def _rmse_of_each(
    estimates: Mapping[str, ParkEstimate], reference: ParkEstimate
) -> dict[str, dict[str, float]]:
    return {name: rmse(estimate, reference) for name, estimate in estimates.items()}


def _stored(folder: Path, log: AssociatedLog) -> XGni | None:
    """Return the authors' solution of the log, or None if the folder does not have it."""
    path = batch_solution.find(folder)
    if path is None:
        return None
    stored = batch_solution.read(path)
    ids = {s.id for observations in log.observations for s in observations}
    if len(stored.poses) > len(log.observations) or stored.points.keys() != ids:
        raise UserError(f'{path} is the solution of another log; fetch the file again')
    return stored


def _as_truth(estimate: ParkEstimate) -> Iterator[TruePose | TrueLandmarks]:
    yield TrueLandmarks(estimate.points)
    for robot, poses in estimate.poses.items():
        for k, pose in enumerate(poses):
            yield TruePose(robot, park.LOG_START + k * park.STEP_PERIOD, pose)


def _thinned(estimate: ParkEstimate) -> ParkEstimate:
    """Keep the poses of every 50th step only."""
    return replace(
        estimate, poses={robot: x[::CAUSAL_STRIDE] for robot, x in estimate.poses.items()})


def _ends(logs: TeamLogs) -> Indices:
    """Return for each robot the number of poses of it and those before it."""
    return np.cumsum([len(log.observations) for log in logs.values()])


def _as_team(estimate: ParkEstimate, logs: TeamLogs, team: CarTeam) -> ParkEstimate:
    """Return the one car's estimate as that of the robots that it stands for."""
    (car,) = estimate.poses.values()
    return ParkEstimate(
        {robot: car[team.poses[robot][0]:][:len(log.observations)] for robot, log in logs.items()},
        estimate.points)


def _difference(estimate: ParkEstimate, stored: XGni) -> MaxDifference:
    """Return the difference of the one car's estimate from the stored one without last pose."""
    (car,) = estimate.poses.values()
    poses = pose_difference(car[:len(stored.poses)], stored.poses)
    points = np.array([point - stored.points[id_] for id_, point in estimate.points.items()])
    return MaxDifference(
        float(np.linalg.norm(np.concatenate([poses[:, :2], points]), axis=1).max()),
        float(np.abs(poses[:, 2]).max()))
