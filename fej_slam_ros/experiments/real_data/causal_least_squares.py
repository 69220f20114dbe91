# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Least squares over all measurements up to a time, beside a filter at the same time.

A filter does not know later measurements. The newest pose of least squares over all earlier ones
is the best that it can reach with the same noise, but for robots that join later.
"""

from collections.abc import Iterable
from dataclasses import dataclass
import sys
from typing import NamedTuple

import numpy as np

from fej_slam_ros.core.consistency import root_mean_square
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import solve
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NS, Record, TrueLandmarks
from fej_slam_ros.core.settings import Settings

#: Time between two solutions [ns].
PERIOD = 60 * NS


@dataclass(frozen=True, slots=True)
class CausalErrors:
    """Position errors of the newest poses in ``map`` that have ground truth."""

    poses: int  #: Number of poses
    #: RMSE of least squares and of the filter [m].
    least_squares: float
    filter: float


class Newest(NamedTuple):
    """The newest pose (3,) of a robot, by both."""

    robot: str
    stamp: int
    smoothed: Array
    filtered: Array


def causal_least_squares(
    settings: Settings, records: Iterable[Record]
) -> tuple[TeamSmoother, CausalErrors]:
    """Return the smoother after all records, solved, and the errors once in a `PERIOD`."""
    estimator, team = Estimator(settings), TeamSmoother(settings, sys.maxsize)
    newest: list[Newest] = []
    due: int | None = None
    for record in records:
        estimator.add(record)
        team.add(record)
        for _ in estimator.take():
            pass
        for _ in team.take():
            pass
        if isinstance(record, TrueLandmarks):
            continue
        due = record.stamp + PERIOD if due is None else due
        if record.stamp >= due:
            due += PERIOD
            team.adopt(solve(team.task()))
            newest += _newest(estimator, team)
    for _ in team.close():
        pass
    team.adopt(solve(team.task()))
    return team, _errors(team, newest)


def _newest(estimator: Estimator, team: TeamSmoother) -> Iterable[Newest]:
    for name, trajectory in team.trajectories.items():
        smoothed, filtered = trajectory.newest(), estimator.pose(name)
        if smoothed.frame == filtered.frame == MAP and smoothed.stamp == filtered.stamp:
            yield Newest(name, smoothed.stamp, smoothed.pose, filtered.pose)


def _errors(team: TeamSmoother, newest: Iterable[Newest]) -> CausalErrors:
    errors = [
        (estimate.smoothed[:2] - true[:2], estimate.filtered[:2] - true[:2]) for estimate in newest
        if (true := team.truth.find(estimate.robot, estimate.stamp)) is not None]
    of_both = np.array(errors).reshape(-1, 2, 2)
    return CausalErrors(
        len(errors), root_mean_square(of_both[:, 0]), root_mean_square(of_both[:, 1]))
