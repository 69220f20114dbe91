# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the estimator, live or from a bag: messages in, publications and files out."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import Any

from fej_slam_ros.core.estimates import StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.records import PriorMap
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.files.run_files import RunFiles
from fej_slam_ros.ros.files.run_summary import estimator_summary
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import ParameterChange, RunSettings
from fej_slam_ros.ros.published_maps import estimator_maps
from fej_slam_ros.ros.session.estimator_outputs import EstimatorOutputs
from fej_slam_ros.ros.session.estimator_reports import EstimatorDiagnostics, EstimatorLog
from fej_slam_ros.ros.session.inputs import Inputs, restored_inputs
from fej_slam_ros.ros.session.late_starts import LateStarts, MissedMessages
from fej_slam_ros.ros.session.outputs import Publication, rejections
from fej_slam_ros.ros.session.session import FilesOpener, Session


class EstimatorSession(Session):
    """
    An estimator between its inputs and outputs.

    Parameters
    ----------
    settings, folder, force, open_files : as for every `Session`
    outputs : class of the outputs, which decides what is published
    prior : prior map that was read before; None: it is read if the settings name one

    Attributes
    ----------
    prior : prior map, None without one
    changes : changes of parameters of estimation since the start of the run

    """

    outputs: EstimatorOutputs
    diagnostics: EstimatorDiagnostics
    log: EstimatorLog

    def __init__(
        self, settings: RunSettings, folder: Path | None, force: bool | None = None,
        outputs: type[EstimatorOutputs] = EstimatorOutputs, open_files: FilesOpener = RunFiles,
        prior: PriorMap | None = None,
    ) -> None:
        self.settings = settings
        self.prior = prior or prior_map(settings)
        self.is_restored = checkpoint.is_to_restore(settings.node)
        self.changes: list[ParameterChange] = []
        if self.is_restored:
            path = Path(settings.node.restore)
            self.settings, self.estimator, inputs, self.changes = checkpoint.load(
                path, settings, self.prior)
            self.inputs = restored_inputs(path, inputs, self.estimator, settings.node)
        else:
            self.estimator = Estimator(settings.estimation, self.prior)
            self.inputs = Inputs(self.estimator, settings.node)
        self.consumer = self.estimator
        self.inputs.initialpose_robot = self.estimator.settings.initialpose_robot
        self.outputs = outputs(self.estimator, self.inputs, settings.node)
        self.diagnostics = EstimatorDiagnostics(self.estimator, self.inputs, settings.node)
        self.log = EstimatorLog(self.estimator, self.inputs)
        self._files = None if folder is None else open_files(
            folder, self.estimator.robots, force)

    def receive(self, message: RawMessage) -> Iterable[Publication]:
        super().receive(message)
        return self.outputs.predictions()

    def write_files(self) -> dict[str, Any]:
        content = {
            'state_hash': self.state_hash(),
            **estimator_summary(self.estimator, self.inputs.unused, self.settings),
            'parameter_changes': [*map(asdict, self.changes)], **self.source}
        if self._files is not None:
            shared_ids = self.settings.estimation.shared_landmark_ids
            self._files.complete(
                (), estimator_maps(self.estimator), shared_ids, summary=content)
        return content

    def check_starts(self, messages: MissedMessages) -> None:
        """Expect robots that had moved before their first odometry arrives, as in a live run."""
        self.inputs.start_check = LateStarts(
            self.estimator, messages, self.log.add, self.inputs.start_check.held())

    def change_team(self, names: object) -> None:
        before = self.estimator.robots
        robots = parameters.changed_team(self.estimator.settings, before, names)
        remaining = [robot.name for robot in robots]
        removed = [name for name in before if name not in remaining]
        for name in removed:
            if not self.estimator.groups.may_leave(name):
                raise UsageError(
                    f'the anchor {name!r} cannot be removed before it has seen a landmark: keep it'
                    ' in robots until then')
        if self._files is not None:
            self._files.add_robots(remaining)
        for name in removed:
            self.inputs.remove_robot(name)
            self.outputs.remove_robot(name)
        self.estimator.change_team(robots)
        present = [*self.estimator.robots]
        if present != [*before]:
            self.changes.append(
                ParameterChange('robots', [*before], present, self._last_step()))

    def change_parameters(self, values: Mapping[str, Any]) -> None:
        """Change parameters of estimation from the next step on; the values are checked."""
        before = self.present_settings()
        # Robots of the start that have left may return.
        all_robots = {
            robot.name: robot for robot in (*self.estimator.settings.robots, *before.robots)}
        known = replace(before, robots=tuple(all_robots.values()))
        changed = parameters.with_values(known, values.items())
        robots = {robot.name: robot for robot in changed.robots}
        at_start = [robots[robot.name] for robot in self.estimator.settings.robots]
        self.estimator.change_team(
            [robots[robot.name] for robot in before.robots],
            replace(changed, robots=tuple(at_start)))
        self.inputs.initialpose_robot = changed.initialpose_robot
        earlier, later = parameters.deciding(known), parameters.deciding(changed)
        self.changes += [
            ParameterChange(name, earlier[name], later[name], self._last_step())
            for name in values if later[name] != earlier[name]]

    def present_settings(self) -> Settings:
        return replace(
            self.estimator.settings, robots=tuple(self.estimator.robots.values()))

    def _last_step_of(self, robot: str) -> int:
        groups = self.estimator.groups
        if robot in groups.not_in_map:
            raise UsageError(f'{robot} is not in map: {groups.not_in_map[robot]}')
        if not groups.may_leave(robot):
            raise UsageError(
                f'the anchor {robot} has observed no landmark yet, so its pose defines map:'
                f' publish {robot}/set_pose to place it elsewhere')
        return groups.team.robots[robot].stamp

    def _checkpoint_content(self) -> bytes:
        return checkpoint.content_of(
            self.settings, self.estimator, self.inputs.snapshot(), self.prior, self.changes)

    def _last_step(self) -> int | None:
        return max((
            robot.stamp for state in self.estimator.groups.states()
            for robot in state.robots.values()), default=None)

    def _publications(self, results: Iterator[StepResult]) -> Iterator[Publication]:
        begin = perf_counter()
        for result in results:
            if self._files is not None:
                self._files.write(result.poses)
            self.log.add_step(result)
            yield from self.outputs.of_step(result)
            end = perf_counter()
            self.diagnostics.step_times.append(end - begin)
            begin = end
        self.log.add_rejections(self.estimator.statistics.rejections)
        yield from rejections(self.estimator.statistics)
        # Odometry that came before the first step of its robot.
        yield from self.outputs.predictions()
