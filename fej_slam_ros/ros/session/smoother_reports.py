# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Reports of a smoother: its diagnostics and its log."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.frame_names import MAP
from fej_slam_ros.ros.messages import Message
from fej_slam_ros.ros.session.diagnostics import Diagnostics, percentile_values
from fej_slam_ros.ros.session.faults import Level
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.log_lines import LogSeverity
from fej_slam_ros.ros.session.run_log import Missing, RunLog


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


class SmootherLog(RunLog[TeamSmoother]):
    """The log of one run of a smoother."""

    def __init__(self, team: TeamSmoother, inputs: Inputs) -> None:
        super().__init__(team, inputs)
        self._joined: set[str] = set()
        self._unsolved: set[str] = set()
        self._lost: set[str] = set()
        self._begins: dict[str, int] = {}

    def add_poses(self) -> None:
        """Add the lines of robots that were lost or found, or started over, by now."""
        team = self._consumer
        for robot in [*self._inputs.health.pose_priors]:
            if robot in team.trajectories:
                self._note_priors(robot, team.trajectories[robot].newest().stamp)
        self._add_lost(team)
        self._add_restarts(team)

    def _add_lost(self, team: TeamSmoother) -> None:
        lost = {robot for robot, trajectory in team.trajectories.items() if trajectory.is_lost}
        for robot in sorted(lost - self._lost):
            reason = team.statistics.restart_reasons[robot]
            self.add(LogSeverity.WARN, f'{robot} goes on in its own frame: {reason}')
        for robot in sorted(self._lost - lost):
            # Only a run that has never been lost has no restart.
            found = 'is found by the landmarks of its map'
            what = found if team.statistics.relocalized[robot] else 'has begun a new run'
            self.add(LogSeverity.INFO, f'{robot} {what}')
        self._lost = lost

    def _add_restarts(self, team: TeamSmoother) -> None:
        begins = {robot: trajectory.stamps[0] for robot, trajectory in team.trajectories.items()}
        for robot, begin in begins.items():
            if begin > self._begins.get(robot, begin) and team.statistics.relocalized[robot]:
                reason = team.statistics.restart_reasons[robot]
                self.add(LogSeverity.WARN, f'{robot} starts over, without its map: {reason}')
        self._begins = begins

    def add_solution(self, failed: Mapping[str, str]) -> None:
        """Add the lines of an adopted solution, or of the robots whose solution failed."""
        unsolved = {**self._consumer.solution.unsolved, **failed}
        for robot, trajectory in self._consumer.trajectories.items():
            if trajectory.frame == MAP and robot not in self._joined:
                self._joined.add(robot)
                self.add(LogSeverity.INFO, f'{robot} joined {MAP}, by {self._cause(robot)}')
        for robot in sorted(unsolved.keys() - self._unsolved):
            self.add(LogSeverity.WARN, f'{robot} is not smoothed: {unsolved[robot]}')
        for robot in sorted(self._unsolved - unsolved.keys()):
            self.add(LogSeverity.INFO, f'{robot} is smoothed again')
        self._unsolved = {*unsolved}

    def _needs(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        for robot, reason in self._consumer.not_in_map().items():
            if robot in self._consumer.trajectories:
                yield Missing(f'{robot} to join {MAP}', reason)

    def _cause(self, robot: str) -> str:
        """Return by what a robot joined."""
        is_anchor = robot == self._consumer.settings.anchor
        return 'its anchor_pose' if is_anchor else 'observations of robots and shared landmarks'
