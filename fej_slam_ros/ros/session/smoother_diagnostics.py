# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of the smoother: state of each robot, size and times of the solution."""

from collections.abc import Mapping
from types import MappingProxyType

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.session.diagnostics import Diagnostics, percentile_values
from fej_slam_ros.ros.session.input_faults import Level


class SmootherDiagnostics(Diagnostics[TeamSmoother]):
    """Reports on a smoother and its inputs."""

    node_name = 'smoother'
    solve_time = 0.0  #: duration of the last solution [s]
    solver_restarts = 0  #: number of worker processes that have died, set by the caller
    solver_fault = ''  #: how the last one died, '' after the next solution, set by the caller
    #: why the last solution of robots failed, by name, set by the caller
    failed: Mapping[str, str] = MappingProxyType({})

    def _needs_observations(self, robot: str) -> bool:
        return robot in self._consumer.not_in_map()

    def _publishes_tf(self) -> bool:
        return self.settings.publish_smoothed_tf

    def _state_of(self, robot: str) -> tuple[Level, str]:
        team = self._consumer
        trajectory = team.trajectories.get(robot)
        error = (
            (trajectory and trajectory.error) or team.solution.unsolved.get(robot)
            or self.failed.get(robot))
        if error:
            return Level.ERROR, f'not smoothed: {error}'
        not_joined = team.not_in_map().get(robot)
        if not_joined:
            return Level.WARN, f'{robot} not joined: {not_joined}'
        return Level.OK, f'in {MAP}'

    def _values_of(self, robot: str) -> dict[str, object]:
        return {'steps': self._consumer.steps[robot], **self._clock_values(robot)}

    def _overall(self, now: int, at_rest: bool) -> Message:
        team, trajectories = self._consumer, self._consumer.trajectories.values()
        state = {'state_hash': team.state_hash()} if at_rest else {}
        warnings = [self.solver_fault] if self.solver_fault else []
        return self._status('smoother', now, warnings, {
            'robots': sum(trajectory.frame == MAP for trajectory in trajectories),
            'landmarks': team.solution.landmarks_in_map(),
            'poses': sum(len(trajectory.stamps) for trajectory in trajectories),
            'poses_since_solution': team.new_poses,
            'solve_time_s': round(self.solve_time, 6),
            'solver_restarts': self.solver_restarts,
            'steps': len(self.step_times),
            **percentile_values('step', self.step_times),
            **percentile_values('hold', self.callback_times),
            **state,
        })
