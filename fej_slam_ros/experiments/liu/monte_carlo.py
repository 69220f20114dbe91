# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Monte Carlo runs: one world, repeated measurements, and the errors of each filter.

A run depends on its task only, so it is the same in any process and any selection of runs.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array, pose_difference
from fej_slam_ros.core.ordering.input_statistics import InputStatistics
from fej_slam_ros.core.ordering.sequencer import Sequencer
from fej_slam_ros.core.records import Odometry, Record, RobotScan, Scan, Step
from fej_slam_ros.core.settings import numbered_robots, Settings
from fej_slam_ros.experiments.liu.configurations import Configuration, TABLE_FILTERS
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import World


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Errors of one run, or of several stacked along the first axis."""

    #: (..., 3, K) array of each robot: squared position error [m^2], squared heading error [rad^2]
    #: and NEES/3 at each step; without the first robot's exactly known start.
    poses: Mapping[str, Array]
    #: (..., 2, n) array: squared error [m^2] and NEES/2 of each landmark of the final map, in the
    #: order of IDs.
    landmarks: Array


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloTask:
    """One run."""

    #: Ground truth and sensors.
    world: World
    sensors: SensorSettings
    filters: tuple[str, ...]  #: Names of the filters that estimate from the same measurements
    seed: tuple[int, ...]  #: Entropy of the noise


#: Minimum number of landmarks of a map from which an uncertain robot restarts in its own frame:
#: more than there are, since in [Liu] robots stay in the frame, however uncertain they are.
NEVER_RESTART = 1000
#: Errors of stacked runs, by experiment and by the filter's name in the tables.
TableRuns = Mapping[Configuration, Mapping[str, Errors]]


def table_tasks(
    worlds: Mapping[Configuration, World], seed: int, runs: Sequence[int]
) -> list[MonteCarloTask]:
    """Return the runs of Tables 1 and 2 with the given numbers, experiment by experiment."""
    return [
        MonteCarloTask(world, configuration.simulated.sensors, tuple(TABLE_FILTERS.values()),
                       (seed, *configuration, run))
        for configuration, world in worlds.items() for run in runs]


def table_runs(
    worlds: Mapping[Configuration, World], finished: Sequence[Mapping[str, Errors]], runs: int
) -> TableRuns:
    """Return the results of the first finished tasks, by experiment and filter."""
    of_each = [finished[k * runs:(k + 1) * runs] for k in range(len(worlds))]
    return {
        configuration: {
            name: stack([run[filter_name] for run in done])
            for name, filter_name in TABLE_FILTERS.items()}
        for configuration, done in zip(worlds, of_each) if done}


def simulate(task: MonteCarloTask) -> dict[str, Errors]:
    """Return the errors of each filter in a run."""
    rng, settings = np.random.default_rng(task.seed), _settings(task.world)
    truth: list[Record] = []
    sequencer = Sequencer(settings, InputStatistics())
    for record in measure(task.world, task.sensors, rng):
        if isinstance(record, (Odometry, Scan, RobotScan)):
            sequencer.add(record, None)
        else:
            truth.append(record)
    steps = list(sequencer.release())
    return {
        name: _estimate(task.world, replace(settings, filter=name), truth, steps)
        for name in task.filters}


class _Ordered(Sequencer):
    """Measurements of which the steps are known: they are the same for all filters."""

    def __init__(self, settings: Settings, steps: Iterable[Step]) -> None:
        super().__init__(settings, InputStatistics())
        self._steps = steps

    def release(self) -> Iterator[Step]:
        yield from self._steps


def stack(runs: Sequence[Errors]) -> Errors:
    """Return the errors of several runs in one world."""
    return Errors(
        {name: np.stack([run.poses[name] for run in runs]) for name in runs[0].poses},
        np.stack([run.landmarks for run in runs]))


def _settings(world: World) -> Settings:
    """Return the parameters of a run, in which step 0 places each robot however it is known."""
    x, y, phi = world.true_poses[world.robots[0]][0].tolist()
    robots = numbered_robots(world.robots)
    return Settings(
        robots, anchor=robots[0].name, anchor_pose=(x, y, phi), gate_probability=1.0,
        join_min_landmarks=NEVER_RESTART, join_heading_sigma=np.pi)


def _estimate(
    world: World, settings: Settings, truth: Iterable[Record], steps: Iterable[Step]
) -> Errors:
    """Return the errors of one filter."""
    estimator = Estimator(settings)
    # For the others, true poses would make it evaluate each step, which is done below at once.
    if settings.filter == 'ideal':
        for record in truth:
            estimator.add(record)
    estimator.sequencer = _Ordered(settings, steps)
    results = list(estimator.close())
    if any(pose.frame != MAP for result in results for pose in result.poses):
        raise RuntimeError('a robot has left map, where all robots of [Liu] stay')
    poses = {
        name: _pose_errors(
            pose_difference(
                np.array([result.poses[i].pose for result in results]), world.true_poses[name]),
            np.array([result.poses[i].P for result in results]))
        for i, name in enumerate(world.robots)}
    return Errors(poses, _landmark_errors(estimator, world))


def _pose_errors(errors: Array, P: Array) -> Array:
    first = 0 if P[0].any() else 1
    e, P = errors[first:], P[first:]
    return np.stack([np.sum(e[:, :2] ** 2, axis=1), e[:, 2] ** 2, nees_per_dof(e, P)])


def _landmark_errors(estimator: Estimator, world: World) -> Array:
    team = estimator.maps()[0]
    errors = team.points - np.array([world.landmarks[id_] for _, id_ in team.keys])
    return np.stack([np.sum(errors**2, axis=1), nees_per_dof(errors, team.P)])
