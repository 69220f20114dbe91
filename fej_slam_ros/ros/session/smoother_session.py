# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the smoother, live or from a bag: messages in, publications and files out."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from heapq import merge
from itertools import chain
from pathlib import Path
from time import monotonic_ns
from typing import Any

from fej_slam_ros.core.csam.matched_smoother import MatchedTeamSmoother
from fej_slam_ros.core.csam.message_sizes import MessageSizes, smallest, solution_and_sizes
from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.csam.team_solution import SmoothedMap, solve, TeamMap
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.matches import Matches
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import CommonSettings, Settings
from fej_slam_ros.core.smoothing.incremental import SOLVE_EVERY
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.files.run_files import RunFiles
from fej_slam_ros.ros.files.run_summary import smoother_summary
from fej_slam_ros.ros.parameters import RunSettings
from fej_slam_ros.ros.published_maps import smoother_maps
from fej_slam_ros.ros.session.inputs import Inputs, restored_inputs
from fej_slam_ros.ros.session.late_starts import LateAnchor, MissedMessages
from fej_slam_ros.ros.session.outputs import Publication, rejections
from fej_slam_ros.ros.session.session import FilesOpener, Session
from fej_slam_ros.ros.session.smoother_outputs import SmootherOutputs
from fej_slam_ros.ros.session.smoother_reports import SmootherDiagnostics, SmootherLog

#: A function of plain values, which may take long, and its argument.
Solving = tuple[Callable[[Any], Any], Any]
#: Calls such a function, or returns None if the process is to end at once.
Solver = Callable[[Callable[[Any], Any], Any], Any]
#: Time [ns] for which a computation that raised exceptions is not tried with more input: one that
#: fails each time would keep a core busy.
FAILURE_PAUSE = 60 * NS


class SmootherSession(Session):
    """
    A smoother between its inputs and outputs.

    Parameters
    ----------
    settings, folder, force, open_files : as for every `Session`
    solve_every : minimum number of new poses with observations after which a robot's own map is
        solved
    solve_finally : calls the function that computes the final solution with its argument, or
        returns None to keep the last one

    Attributes
    ----------
    message_sizes : sizes [bytes] of messages that align maps, for each pair that met

    """

    outputs: SmootherOutputs
    diagnostics: SmootherDiagnostics
    log: SmootherLog

    def __init__(
        self, settings: RunSettings, folder: Path | None, force: bool | None = None,
        solve_every: int = SOLVE_EVERY, open_files: FilesOpener = RunFiles,
        solve_finally: Solver = lambda function, argument: function(argument),
    ) -> None:
        _refuse_exact_odometry(settings.estimation)
        self.settings = settings
        self._create(solve_every)
        self.message_sizes: MessageSizes = {}
        self._solve_finally = solve_finally
        self._pause_end = 0  # of solutions [ns]
        self._files = None if folder is None else open_files(
            folder, self.team.robots, force, ['alignment.json'])

    def _create(self, solve_every: int) -> None:
        """Create the smoother, its inputs and outputs, and what reports on it."""
        node = self.settings.node
        self.is_restored = checkpoint.is_to_restore(node)
        if self.is_restored:
            path = Path(node.restore)
            self.settings, self.team, inputs = checkpoint.load_smoother(path, self.settings)
            self.inputs = restored_inputs(path, inputs, self.team, node)
        else:
            self.team = self._new_team(solve_every)
            self.inputs = Inputs(self.team, node)
        self.consumer = self.team
        self.outputs = SmootherOutputs(self.team, self.inputs, node)
        self.diagnostics = SmootherDiagnostics(self.team, self.inputs, node)
        self.log = SmootherLog(self.team, self.inputs)

    def _new_team(self, solve_every: int) -> TeamSmoother:
        return TeamSmoother(self.settings.estimation, solve_every)

    def check_starts(self, messages: MissedMessages) -> None:
        """Expect an anchor that had moved before its first odometry arrives, as in a live run."""
        if self.settings.estimation.anchor in self.team.trajectories:
            return
        self.inputs.start_check = LateAnchor(
            self.settings.estimation, messages, self.log.add)

    def close(self) -> Iterator[Publication]:
        """Process the last steps at the end of the input, and solve for everything."""
        yield from super().close()
        final = self._solve_finally(*self.final_solving())
        if final is not None:
            yield from self.adopt_finally(final)
        self.team.count_outliers()
        yield from rejections(self.team.statistics)

    def exchange(self) -> Iterable[Publication]:
        """Return what is due to be sent to other smoothers; a central one sends nothing."""
        return ()

    def is_solution_due(self, new_poses: int) -> bool:
        """Return whether there is something to compute, if it takes some new poses."""
        return monotonic_ns() >= self._pause_end and (
            self.team.new_measurements > 0 or self.team.new_poses >= new_poses)

    def solving(self) -> Solving:
        """Return what computes the next solution from all input so far."""
        return solve, self.team.task()

    def final_solving(self) -> Solving:
        """Return what computes the solution at the end of the input."""
        return solution_and_sizes, self.team.task()

    def adopt(self, solution: TeamMap) -> Iterator[Publication]:
        """Adopt a solution and return its publications."""
        self.team.adopt(solution)
        return self._adopted()

    def give_up(self, task: Any, error: str) -> None:
        """Report the error for which a task has no result; the solution before stays."""
        self._report_unsolved((local.robot for local in task.maps), error)

    def adopt_finally(self, final: tuple[TeamMap, MessageSizes]) -> Iterator[Publication]:
        """Adopt the solution at the end of the input and return its publications."""
        solution, self.message_sizes = final
        return self.adopt(solution)

    def write_files(self) -> dict[str, Any]:
        content = {
            'state_hash': self.state_hash(),
            **smoother_summary(self.team, self.inputs.unused, self.settings), **self.source}
        if self._files is not None:
            shared_ids = self.settings.estimation.shared_landmark_ids
            poses = chain.from_iterable(
                trajectory.estimates() for name, trajectory in self.team.trajectories.items()
                if self.team.is_smoothed(name))
            self._files.complete(
                poses, smoother_maps(self.team), shared_ids, summary=content,
                alignment=self.alignment())
        return content

    def alignment(self) -> dict[str, Any]:
        """Return the content of ``alignment.json``: base nodes of the maps and what they share."""
        solution = self.team.solution
        return {
            'maps': [_aligned(solved) for solved in solution.maps],
            'not_joined': [
                {'robots': list(failed.robots), 'reason': failed.reason}
                for failed in solution.not_joined],
            'released_odometry': self.released_odometry(),
            'scaled_joins': [asdict(join) for join in solution.scaled],
            'unsolved': {**solution.unsolved, **self.diagnostics.failed},
            'messages': [
                {'sender': sender, 'receiver': receiver, 'bytes': sizes,
                 'smallest': smallest(sizes)}
                for (sender, receiver), sizes in self.message_sizes.items()],
        }

    def released_odometry(self) -> list[dict[str, Any]]:
        """Return the robot, the intervals and the observations of each slip that was found."""
        return [
            {'robot': released.robot, 'intervals_ns': [
                [self.team.trajectories[released.robot].stamps[pose] for pose in interval]
                for interval in released.intervals], 'observations': released.observations}
            for released in self.team.solution.released]

    def _last_step_of(self, robot: str) -> int:
        trajectory = self.team.trajectories.get(robot)
        if trajectory is None or trajectory.is_lost:
            raise UsageError(f'{robot} is in no map: {self.team.not_in_map()[robot]}')
        return trajectory.newest().stamp

    def change_team(self, names: object) -> None:
        robots = parameters.changed_team(
            self.settings.estimation, self.team.robots, names)
        _refuse_exact_odometry(replace(self.settings.estimation, robots=tuple(robots)))
        remaining = [robot.name for robot in robots]
        if self._files is not None:
            self._files.add_robots(remaining)
        for name in [name for name in self.team.robots if name not in remaining]:
            self.inputs.remove_robot(name)
        self.team.change_team(robots)

    def present_settings(self) -> Settings:
        return replace(self.settings.estimation, robots=tuple(self.team.robots.values()))

    def _checkpoint_content(self) -> bytes:
        return checkpoint.content_of_smoother(self.settings, self.team, self.inputs.snapshot())

    def _adopted(self) -> Iterator[Publication]:
        """Report an adopted solution, and return its publications."""
        self.diagnostics.failed = {}
        self.log.add_solution({})
        return self.outputs.of_solution()

    def _report_unsolved(self, robots: Iterable[str], error: str) -> None:
        """Report the error for which robots have no new solution."""
        self._pause_end = monotonic_ns() + FAILURE_PAUSE
        self.diagnostics.failed = dict.fromkeys(robots, error)
        self.log.add_solution(self.diagnostics.failed)

    def _publications(self, poses: Iterator[PoseEstimate]) -> Iterator[Publication]:
        for estimate in poses:
            yield from self.outputs.of_new_pose(estimate)
        self.log.add_poses()
        yield from rejections(self.team.statistics)


class BagSmootherSession(SmootherSession):
    """
    A smoother over a bag, which publishes poses only when all are smoothed.

    Parameters
    ----------
    settings, folder, force : as for every `Session`
    matches : landmarks of observations without ID, None to reject these

    """

    def __init__(
        self, settings: RunSettings, folder: Path | None, force: bool | None = None,
        matches: Matches | None = None,
    ) -> None:
        self._matches = matches
        super().__init__(settings, folder, force)

    def _new_team(self, solve_every: int) -> TeamSmoother:
        if self._matches is None:
            return super()._new_team(solve_every)
        return MatchedTeamSmoother(self.settings.estimation, self._matches, solve_every)

    def smoothed_poses(self) -> Iterator[Publication]:
        """Yield all poses of a closed run."""
        estimates = (of_robot.estimates() for of_robot in self.team.trajectories.values())
        yield from map(
            self.outputs.of_pose, merge(*estimates, key=lambda estimate: estimate.stamp))

    def _publications(self, poses: Iterator[PoseEstimate]) -> Iterator[Publication]:
        for _ in poses:
            pass
        yield from super()._publications(iter(()))


def _aligned(solved: SmoothedMap) -> dict[str, Any]:
    return {
        'frame': solved.frame,
        'robots': list(solved.trajectories),
        'base_nodes': {
            robot: {'pose': base.pose.tolist(), 'covariance': base.P.tolist()}
            for robot, base in solved.base_nodes.items()},
        'chi_square': solved.chi_square,
        'dof': solved.dof,
        'associations': [
            [[robot, number] for robot, number in names]
            for names in solved.landmarks if len(names) > 1],
    }


def _refuse_exact_odometry(settings: CommonSettings) -> None:
    for robot in settings.robots:
        if min(robot.odometry_sigma) == 0.0:
            is_inherited = robot.odometry_sigma == settings.odometry_sigma
            name = 'odometry_sigma' if is_inherited else f'{robot.name}.odometry_sigma'
            raise UsageError(
                f'parameter {name!r} contains 0, by which a smoother cannot divide: give standard'
                ' deviations above 0')
