# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the estimator: consistency and errors of each robot, state of the filter."""

from collections import Counter

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.core.records import NS
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.session.diagnostics import Diagnostics, percentile_values
from fej_slam_ros.ros.session.input_faults import Level

#: NIS is reported when it has been outside its probability band for this time [ns]; a single
#: outlier has a shorter effect.
NIS_PATIENCE = 5 * NS
#: Ratio of NIS to its expectation, or the inverse, above which it is an error, not a warning.
NIS_ERROR = 4.0


class EstimatorDiagnostics(Diagnostics[Estimator]):
    """Reports on an estimator and its inputs."""

    node_name = 'estimator'

    def _values_of(self, robot: str) -> dict[str, object]:
        nis = self._consumer.innovations.nis[robot]
        low, high = nis.band()
        without_ids = self._consumer.landmark_manager.counts.get(robot, Counter())
        return {
            'nis': round(nis.total, 3),
            'nis_dof': nis.dof,
            'nis_ratio': round(nis.nis_per_dof(), 3),
            'nis_band': f'{low:.3f}..{high:.3f}',
            **self._clock_values(robot),
            **{f'unnamed_{event}': n for event, n in without_ids.items()},
            **self._errors(robot),
        }

    def _errors(self, robot: str) -> dict[str, float]:
        """Return RMSE and NEES of a robot's poses, empty without ground truth."""
        score = self._consumer.evaluation.scores.get(robot)
        if score is None:
            return {}
        nees = {'nees': score.mean_nees_per_dof(), 'nees_latest': score.latest_nees_per_dof}
        return {
            'position_rmse_m': round(score.position_rmse(), 6),
            'heading_rmse_rad': round(score.heading_rmse(), 6),
            **{name: round(value, 3) for name, value in nees.items() if value is not None},
        }

    def _needs_observations(self, robot: str) -> bool:
        return self._is_before_step_0(robot) or robot in self._consumer.groups.not_in_map

    def _publishes_tf(self) -> bool:
        return self.settings.publish_tf

    def _is_before_step_0(self, robot: str) -> bool:
        estimator = self._consumer
        return robot == estimator.settings.anchor and not estimator.groups.is_initialized

    def _state_of(self, robot: str) -> tuple[Level, str]:
        nis = self._consumer.innovations.nis[robot]
        level, message = _consistency(nis)
        lost = self._consumer.innovations.lost_robots.reason(robot)
        if lost:
            # Covariances that are far too small are a cause, too.
            is_overconfident = level > Level.OK and nis.nis_per_dof() > 1.0
            cause = f'; {message}' if is_overconfident else ''
            return Level.ERROR, f'likely lost: {lost}{cause}'
        not_joined = self._consumer.groups.not_in_map.get(robot)
        if not_joined:
            return Level.WARN, f'{robot} not joined: {not_joined}'
        if self._is_before_step_0(robot):
            return Level.OK, f'in {MAP}; no landmark observed yet'
        return level, message

    def _overall(self, now: int, at_rest: bool) -> Message:
        estimator = self._consumer
        state = {'state_hash': estimator.state_hash()} if at_rest else {}
        moved = [
            f'{robot}:{id_}' if robot else str(id_)
            for robot, id_ in estimator.groups.moved_landmarks()]
        if moved:
            state['moved_landmarks'] = ', '.join(moved)
        warnings = ['landmarks were moved'] if moved else []
        team = estimator.groups.team.state
        confirmed = len(team.confirmed_landmarks())
        return self._status('filter', now, warnings, {
            'filter': estimator.settings.filter,
            'robots': len(team.robots),
            'landmarks': confirmed,
            'provisional_landmarks': len(team.landmarks) - confirmed,
            'steps': len(self.step_times),
            **percentile_values('step', self.step_times),
            **percentile_values('latency', self.latencies),
            **state,
        })


def _consistency(nis: NisMonitor) -> tuple[Level, str]:
    """Return level and message of a robot in ``map`` by its NIS."""
    if nis.outside_for < NIS_PATIENCE:
        return Level.OK, 'in map'
    ratio = nis.nis_per_dof()
    over = ratio > 1.0
    factor = ratio if over else 1.0 / max(ratio, 1e-9)
    level = Level.ERROR if factor >= NIS_ERROR else Level.WARN
    return level, f'{"over" if over else "under"}confident by a factor of {factor:.1f}'
