# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Content of ``summary.json``: input statistics, errors against ground truth, configuration."""

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
import math
import platform
from typing import Any

import numpy as np
import scipy

from fej_slam_ros import __version__
from fej_slam_ros.core.consistency import nees_per_dof
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP, own_frame
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.pose_evaluation import PoseScore
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.ros.parameters import as_parameters, RunSettings


def estimator_summary(
    estimator: Estimator, unused_topics: Mapping[str, int], settings: RunSettings
) -> dict[str, Any]:
    """Return the content of ``summary.json`` for a run of the estimator."""
    in_map = estimator.groups.team.robots
    return {
        **_input_figures(estimator, lambda name: MAP if name in in_map else own_frame(name)),
        'not_in_map': estimator.groups.not_in_map,
        'landmarks': len(estimator.groups.team.state.confirmed_landmarks()),
        'without_identity': {
            name: dict(counts) for name, counts in estimator.landmark_manager.counts.items()},
        'unused_topics': dict(unused_topics),
        'nis': {
            name: {'sum': nis.total, 'dof': nis.dof, 'per_dof': nis.total / nis.dof}
            for name, nis in estimator.innovations.nis.items() if nis.dof},
        **_errors(estimator.evaluation.scores, _landmark_errors(estimator)),
        **_environment(settings),
    }


def smoother_summary(
    team: TeamSmoother, unused_topics: Mapping[str, int], settings: RunSettings
) -> dict[str, Any]:
    """Return the content of ``summary.json`` for a run of the smoother."""
    return {
        **_input_figures(
            team, lambda name: (
                team.trajectories[name].frame if name in team.trajectories else own_frame(name))),
        'not_in_map': team.not_in_map(),
        'landmarks': team.solution.landmarks_in_map(),
        'between_keyframes': dict(team.between_keyframes),
        'unused_topics': dict(unused_topics),
        **_errors(team.scores(), _smoothed_errors(team)),
        **_environment(settings),
    }


def _input_figures(
    consumer: Estimator | TeamSmoother, frame: Callable[[str], str]
) -> dict[str, Any]:
    """Return the input statistics, with the frame of each robot."""
    statistics = consumer.statistics
    names = sorted({*consumer.robots, *statistics.received, *statistics.rejection_counts})
    return {
        'depends_on_arrival': statistics.depends_on_arrival(),
        'counts': {
            'used': sum(consumer.used(name) for name in names),
            **{reason.value: statistics.total(reason) for reason in RejectionReason},
            'released_without': sum(statistics.released_without.values()),
        },
        'robots': {
            name: {
                'steps': consumer.steps[name],
                'received': statistics.received[name],
                'used': consumer.used(name),
                'refused': statistics.rejected[name],
                'sightings_used': statistics.observations_used[name],
                'located_anew': statistics.relocalized[name],
                'set_poses_used': statistics.pose_priors_used[name],
                'refusals': {
                    reason.value: n for reason, n in statistics.rejection_counts[name].items()},
                'frame': frame(name),
            } for name in names},
    }


def _environment(settings: RunSettings) -> dict[str, Any]:
    return {
        'config': as_parameters(settings),
        'versions': {
            'fej_slam_ros': __version__, 'rosbags': version('rosbags'),
            'numpy': np.__version__, 'scipy': scipy.__version__,
            'python': platform.python_version(), 'machine': platform.machine(),
            'kernel': KERNEL.NAME},
    }


def _errors(
    scores: Mapping[str, PoseScore], landmarks: Sequence[tuple[Array, Array]]
) -> dict[str, Mapping[str, Any]]:
    """Return RMSE and NEES of poses, and of landmarks given as errors and covariances."""
    rmse: dict[str, Any] = {
        name: {
            'steps': score.steps, 'position': score.position_rmse(),
            'heading': score.heading_rmse()}
        for name, score in scores.items()}
    ratings: dict[str, Any] = {name: score.mean_nees_per_dof() for name, score in scores.items()}
    if landmarks:
        rmse['landmarks'] = math.sqrt(sum(float(e @ e) for e, _ in landmarks) / len(landmarks))
        total = sum(float(nees_per_dof(e, P)) for e, P in landmarks)
        ratings['landmarks'] = total / len(landmarks)
    return {'rmse': rmse, 'nees': ratings} if rmse else {}


def _landmark_errors(estimator: Estimator) -> list[tuple[Array, Array]]:
    truth = estimator.truth.landmarks
    if not (truth and estimator.settings.shared_landmark_ids):
        return []
    return [
        (landmark.position - truth[landmark.id], landmark.P)
        for landmark in estimator.landmarks() if landmark.id in truth]


def _smoothed_errors(team: TeamSmoother) -> list[tuple[Array, Array]]:
    truth = team.truth.landmarks
    return [
        (point - truth[number], P)
        for solved in team.solution.maps
        if solved.frame == MAP and team.settings.shared_landmark_ids
        for ((_, number), *_), point, P in zip(solved.landmarks, solved.points, solved.P)
        if number in truth]
