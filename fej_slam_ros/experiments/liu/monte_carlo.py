# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Monte Carlo runs: one world, measured again and again, and how far each filter's estimate errs.

A run is decided by its task alone, so it is the same wherever and in whatever company it is made.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.consistency import nees
from fej_slam_ros.core.ekf.state import landmark_estimates
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.geometry import Array, wrap_all
from fej_slam_ros.core.records import Record, TruePose
from fej_slam_ros.core.settings import RobotSettings, Settings
from fej_slam_ros.sim.sensors import measure, SensorSettings
from fej_slam_ros.sim.world import World


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """
    How far one run, or several stacked along the first axis, are from the truth.

    Attributes
    ----------
    poses : (..., 3, K) array of each robot: at each step the squared position error [m^2], the
        squared heading error [rad^2] and the NEES divided by 3; the first robot's exactly known
        start is left out
    landmarks : (..., 2, n) array: of each landmark of the final map the squared error [m^2] and
        the NEES divided by 2, in the order of ids

    """

    poses: Mapping[str, Array]
    landmarks: Array


@dataclass(frozen=True, slots=True, eq=False)
class MonteCarloTask:
    """
    One run.

    Attributes
    ----------
    world, sensors : what is measured
    filters : names of the filters that estimate from the same measurements
    seed : entropy of the noise

    """

    world: World
    sensors: SensorSettings
    filters: tuple[str, ...]
    seed: tuple[int, ...]


def simulate(task: MonteCarloTask) -> dict[str, Errors]:
    """Make a run; return the errors of each filter."""
    rng = np.random.default_rng(task.seed)
    records = list(measure(task.world, task.sensors, rng))
    return {name: estimate(task.world, records, name) for name in task.filters}


def estimate(world: World, records: Sequence[Record], filter_name: str) -> Errors:
    """Return the errors of one filter; the first robot's start is known, as in [Liu]."""
    x, y, phi = world.true_poses[world.robots[0]][0].tolist()
    robots = tuple(RobotSettings(name, number) for number, name in enumerate(world.robots, 1))
    estimator = Estimator(Settings(
        robots, anchor=robots[0].name, anchor_pose=(x, y, phi), filter=filter_name,
        gate_probability=1.0))
    for record in records:
        # Errors are taken from all steps at once; a filter that sees the truth would rate each.
        if filter_name == 'ideal' or not isinstance(record, TruePose):
            estimator.add(record)
    steps = list(estimator.close())
    return Errors(
        {name: _pose_errors(
            np.array([step.poses[i].pose for step in steps]) - world.true_poses[name],
            np.array([step.poses[i].P for step in steps]))
         for i, name in enumerate(world.robots)},
        _landmark_errors(estimator, world))


def stack(runs: Sequence[Errors]) -> Errors:
    """Return the errors of several runs in one world."""
    robots = runs[0].poses
    return Errors(
        {name: np.stack([run.poses[name] for run in runs]) for name in robots},
        np.stack([run.landmarks for run in runs]))


def _pose_errors(errors: Array, P: Array) -> Array:
    errors[:, 2] = wrap_all(errors[:, 2])
    first = 0 if P[0].any() else 1
    e, P = errors[first:], P[first:]
    return np.stack([np.sum(e[:, :2] ** 2, axis=1), e[:, 2] ** 2, nees(e, P)])


def _landmark_errors(estimator: Estimator, world: World) -> Array:
    found = estimator.maps()[0]
    errors = found.points - np.array([world.landmarks[id_] for _, id_ in found.keys])
    return np.stack([np.sum(errors**2, axis=1), nees(errors, found.P)])
