# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Errors and consistency of one run against ground truth.

Errors are given unaligned, after one rigid motion of the whole team that best fits all positions,
and after one rigid motion of each robot, as by evo's ``--align``.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.core.geometry import Array, transform
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.errors import UserError
from fej_slam_ros.evaluation import coverage, errors
from fej_slam_ros.evaluation.run_result import match, RunResult

UNALIGNED, TEAM_ALIGNED, ROBOT_ALIGNED = 'unaligned', 'team_aligned', 'robot_aligned'

#: Errors [m] and [rad] of the poses of a robot, (n,) arrays.
PoseErrors = tuple[Array, Array]


class RunEvaluation:
    """
    Evaluation of a run against ground truth.

    Parameters
    ----------
    result, truth : a run, and ground truth of the same robots
    lengths : lengths of the path segments of RPE [m]

    Attributes
    ----------
    matched : poses of each robot that has any with ground truth
    in_map : those of the robots whose poses are in ``map``
    team_alignment : rigid motion (3,) that best fits the team to the truth, None if undetermined
    nees : NEES/3 of each pose of the robots in ``map``, NaN where the pose is exactly known

    Raises
    ------
    UserError
        No estimated pose has ground truth.

    """

    def __init__(self, result: RunResult, truth: RecordedTruth, lengths: Sequence[float]) -> None:
        self.result, self.truth = result, truth
        self._lengths = lengths
        every = {name: match(name, path, truth) for name, path in result.trajectories.items()}
        self.matched = {name: matched for name, matched in every.items() if len(matched.stamps)}
        if not self.matched:
            estimated, true = (
                ', '.join(robots) or 'no robot' for robots in (every, truth.robots()))
            raise UserError(
                f'the ground truth (of {true}) covers no estimated pose (of {estimated}): give a'
                ' truth of the same robots and time')
        self.in_map = {name: matched for name, matched in self.matched.items() if matched.in_map}
        rated = {n: coverage.pose_consistency(matched) for n, matched in self.in_map.items()}
        self.nees = {name: values for name, (values, _) in rated.items()}
        self._consistency = {name: statistics for name, (_, statistics) in rated.items()}
        self.team_alignment = errors.alignment(self.in_map.values())
        self._alignments = {n: errors.alignment([matched]) for n, matched in self.matched.items()}

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain data."""
        return {
            'robots': {name: self._robot(name) for name in self.result.trajectories},
            'all': {
                'compared': sum(len(matched.stamps) for matched in self.matched.values()),
                'nis': self._nis(self.result.trajectories), **self._errors([*self.matched])},
            'landmarks': self._landmarks(),
            'team_alignment': _plain(self.team_alignment)}

    def _robot(self, name: str) -> dict[str, Any]:
        trajectory, matched = self.result.trajectories[name], self.matched.get(name)
        report: dict[str, Any] = {
            'frame': trajectory.frame, 'poses': trajectory.steps,
            'poses_in_frame': len(trajectory.stamps),
            'compared': 0 if matched is None else len(matched.stamps), 'nis': self._nis([name])}
        if matched is not None:
            report |= self._errors([name])
            report['robot_alignment'] = _plain(self._alignments[name])
        return report

    def _errors(self, names: Sequence[str]) -> dict[str, Any]:
        robots = [self.matched[name] for name in names]
        in_map = [matched for matched in robots if matched.in_map]
        team = self.team_alignment
        return {
            'ape': {
                UNALIGNED: _pooled(map(errors.ape, in_map)),
                TEAM_ALIGNED: None if team is None else _pooled(
                    errors.ape(matched, team) for matched in in_map),
                ROBOT_ALIGNED: _pooled(
                    errors.ape(self.matched[name], motion) for name in names
                    if (motion := self._alignments[name]) is not None)},
            'rpe': {
                f'{length:g}': _pooled(errors.rpe(matched, length) for matched in robots)
                for length in self._lengths},
            'nees': coverage.pooled(
                self._consistency[name] for name in names if name in self._consistency).as_dict()}

    def _nis(self, names: Iterable[str]) -> dict[str, Any] | None:
        sums = [self.result.nis[name] for name in names if name in self.result.nis]
        dof = sum(nis.dof for nis in sums)
        if not dof:
            return None
        return {
            'mean': sum(nis.total for nis in sums) / dof, 'dof': dof,
            'band': band_per_dof(dof)}

    def _landmarks(self) -> dict[str, Any]:
        landmarks = self.result.landmarks
        truth = self.truth.landmarks if self.result.shared_ids else {}
        compared = np.array([id_ in truth for id_ in landmarks.ids.tolist()], dtype=bool)
        report: dict[str, Any] = {
            'in_map': len(landmarks.ids), 'true': len(self.truth.landmarks),
            'compared': int(compared.sum())}
        if compared.any():
            points, team = landmarks.points[compared], self.team_alignment
            true = np.array([truth[id_] for id_ in landmarks.ids[compared].tolist()])
            report[UNALIGNED] = _distances(points, true)
            report[TEAM_ALIGNED] = (
                None if team is None else _distances(transform(team, points), true))
            report['nees'] = coverage.landmark_consistency(
                points - true, landmarks.P[compared]).as_dict()
        return report


def _pooled(robots: Iterable[PoseErrors]) -> dict[str, Any] | None:
    """Return the statistics of the errors of several robots together, None without errors."""
    pose_errors = [*robots]
    if not sum(len(distances) for distances, _ in pose_errors):
        return None
    distances, angles = (np.concatenate([*kind]) for kind in zip(*pose_errors))
    return {
        'position': errors.statistics(distances), 'heading': errors.statistics(angles),
        'samples': len(distances)}


def _distances(points: Array, true: Array) -> dict[str, float]:
    return errors.statistics(np.linalg.norm(points - true, axis=1))


def _plain(pose: Array | None) -> list[float] | None:
    return None if pose is None else pose.tolist()
