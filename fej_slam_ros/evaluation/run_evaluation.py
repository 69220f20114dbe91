# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
All figures of one run against the truth.

Errors are told as estimated, after one rigid motion of the whole team that fits all positions
best, and after one of each robot by itself, which is what evo's ``--align`` does.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np

from fej_slam_ros.core.geometry import Array, transform
from fej_slam_ros.errors import UserError
from fej_slam_ros.evaluation import consistency, errors
from fej_slam_ros.evaluation.run_result import compared, GroundTruth, MatchedPoses, RunResult

UNALIGNED, TEAM_ALIGNED, ROBOT_ALIGNED = 'unaligned', 'team_aligned', 'robot_aligned'

#: Errors [m] and [rad] of the poses of a robot, (n,) arrays.
PoseErrors = tuple[Array, Array]


class RunEvaluation:
    """
    A run beside the truth.

    Parameters
    ----------
    outcome : what came of the run
    truth : of the same robots
    lengths : of the path in the pieces for RPE [m]

    Attributes
    ----------
    compared : the robots, where both are known
    team_alignment : the pose (3,) that moves the team nearest to the truth, None where nothing
        tells it
    ratings : NEES of each pose of the robots that are in ``map``, NaN where it is exactly known

    Raises
    ------
    UserError
        Nothing can be compared.

    """

    def __init__(self, outcome: RunResult, truth: GroundTruth, lengths: Sequence[float]) -> None:
        self.outcome, self.truth = outcome, truth
        self._lengths = lengths
        both = {
            name: compared(way, truth.ways[name])
            for name, way in outcome.ways.items() if name in truth.ways}
        self.compared = {name: of for name, of in both.items() if len(of.stamps)}
        if not self.compared:
            raise UserError(
                f'the truth, of {_list(truth.ways)}, tells no pose of {_list(outcome.ways)} at a'
                ' stamp of the estimate: give a truth of the same robots and the same time')
        rated = {
            name: consistency.rate_poses(of) for name, of in self.compared.items() if of.in_map}
        self.ratings = {name: values for name, (values, _) in rated.items()}
        self._rated = {name: ratings for name, (_, ratings) in rated.items()}
        self.team_alignment = errors.fit(of for of in self.compared.values() if of.in_map)

    @cached_property
    def matched(self) -> tuple[list[int], Array, Array, Array]:
        """Return ids, points (n, 2), true points and covariances of landmarks with a truth."""
        told, true = self.outcome.landmarks, self.truth.landmarks
        if not self.outcome.shared_ids:
            true = {}
        known = np.array([number in true for number in told.ids.tolist()], dtype=bool)
        ids = told.ids[known].tolist()
        at = np.array([true[number] for number in ids]).reshape(-1, 2)
        return ids, told.points[known], at, told.P[known]

    def figures(self) -> dict[str, Any]:
        """Return everything as plain data."""
        names = [*self.outcome.ways]
        return {
            'robots': {name: self._robot(name) for name in names},
            'all': self._all(),
            'landmarks': self._landmarks(),
            'team_alignment': _plain(self.team_alignment),
        }

    def _robot(self, name: str) -> dict[str, Any]:
        way, of = self.outcome.ways[name], self.compared.get(name)
        told: dict[str, Any] = {
            'frame': way.frame, 'poses': way.steps, 'poses_in_frame': len(way.stamps),
            'compared': 0 if of is None else len(of.stamps), 'nis': self._nis([name])}
        if of is not None:
            told |= self._errors([name])
            told['robot_alignment'] = _plain(errors.fit([of]))
        return told

    def _all(self) -> dict[str, Any]:
        names = [*self.compared]
        return {
            'compared': sum(len(of.stamps) for of in self.compared.values()),
            'nis': self._nis(self.outcome.ways), **self._errors(names)}

    def _errors(self, names: Iterable[str]) -> dict[str, Any]:
        """Return the errors of the poses of some robots together."""
        of = [self.compared[name] for name in names]
        in_map = [c for c in of if c.in_map]
        team = self.team_alignment
        return {
            'ape': {
                UNALIGNED: _pooled(in_map, lambda c: errors.ape(c.poses, c.true)),
                TEAM_ALIGNED: None if team is None else _pooled(
                    in_map, lambda c: errors.ape(errors.aligned(c.poses, team), c.true)),
                ROBOT_ALIGNED: _pooled([c for c in of if errors.fit([c]) is not None], _alone),
            },
            'rpe': {f'{length:g}': _pooled_rpe(of, length) for length in self._lengths},
            'nees': consistency.told(consistency.pooled(
                self._rated[name] for name in names if name in self._rated)),
        }

    def _nis(self, names: Iterable[str]) -> dict[str, Any] | None:
        known = [self.outcome.nis[name] for name in names if name in self.outcome.nis]
        dof = sum(nis.dof for nis in known)
        if not dof:
            return None
        return {
            'mean': sum(nis.total for nis in known) / dof, 'dof': dof,
            'band': consistency.nis_band(dof)}

    def _landmarks(self) -> dict[str, Any]:
        _, points, true, P = self.matched
        told: dict[str, Any] = {
            'in_map': len(self.outcome.landmarks.ids), 'true': len(self.truth.landmarks),
            'compared': len(points)}
        if len(points):
            team = self.team_alignment
            told[UNALIGNED] = _distances(points, true)
            told[TEAM_ALIGNED] = (
                None if team is None else _distances(transform(team, points), true))
            told['nees'] = consistency.told(consistency.rate_points(points - true, P))
        return told


def _alone(of: MatchedPoses) -> PoseErrors:
    return errors.ape(errors.aligned(of.poses, errors.fit([of])), of.true)


def _pooled(
    of: Sequence[MatchedPoses], errors_of: Callable[[MatchedPoses], PoseErrors]
) -> dict[str, Any] | None:
    """Return the errors of several robots as one, None where there are none."""
    found = [errors_of(c) for c in of]
    if not sum(len(distances) for distances, _ in found):
        return None
    distances, angles = (np.concatenate([*kind]) for kind in zip(*found))
    return {
        'position': asdict(errors.statistics(distances)),
        'heading': asdict(errors.statistics(angles)), 'samples': len(distances)}


def _pooled_rpe(of: Sequence[MatchedPoses], length: float) -> dict[str, Any] | None:
    return _pooled(of, lambda c: errors.rpe(c.poses, c.true, length))


def _distances(points: Array, true: Array) -> dict[str, float]:
    return asdict(errors.statistics(np.linalg.norm(points - true, axis=1)))


def _plain(pose: Array | None) -> list[float] | None:
    return None if pose is None else pose.tolist()


def _list(names: Iterable[str]) -> str:
    return ', '.join(names) or 'nobody'
