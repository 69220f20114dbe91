# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the estimator, live or from a bag: bytes in, publications and files out."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any

from fej_slam_ros.core.estimates import StepResult
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.ordering.time_jump import Consumer
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files import checkpoint
from fej_slam_ros.ros.files.prior_map import prior_map
from fej_slam_ros.ros.files.run_files import Files, summary
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import NodeSettings, RunSettings
from fej_slam_ros.ros.session.diagnostics import AnyDiagnostics, Diagnostics
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import map_estimates, Outputs, Publication, rejections
from fej_slam_ros.ros.session.smoother_outputs import SmootherOutputs


class Session(ABC):
    """
    What a run of the estimator and one of the smoother have in common.

    Attributes
    ----------
    consumer : the estimator or smoother
    inputs, outputs : what messages go through
    diagnostics : what reports on it
    settings : what the user chose
    source : where the messages come from, for ``summary.json``

    """

    source: Mapping[str, str] = MappingProxyType({})
    settings: RunSettings
    consumer: Consumer
    inputs: Inputs
    outputs: Outputs | SmootherOutputs
    diagnostics: AnyDiagnostics
    _files: Files | None

    def follow(self, earlier: 'Session') -> None:
        """Begin where an earlier run has ended; the true map is not told a second time."""
        self.consumer.truth.landmarks.update(earlier.consumer.truth.landmarks)
        jump = earlier.inputs.time_jump_detector.jump
        if jump is not None:
            self.inputs.time_jump_detector.follow(jump)

    def is_over(self) -> bool:
        """Return whether time has jumped back, and another run is to follow."""
        return self.inputs.time_jump_detector.is_over()

    def receive(self, message: RawMessage) -> None:
        """Take in a message."""
        self.inputs.receive(message)

    @abstractmethod
    def take(self) -> Iterator[Publication]:
        """Do the steps that are due; yield what is to be published of them."""

    @abstractmethod
    def release(self) -> Iterator[Publication]:
        """Finish all steps without waiting for more input."""

    @abstractmethod
    def close(self) -> Iterator[Publication]:
        """Finish the last steps: the input has ended."""

    @abstractmethod
    def keep(self) -> dict[str, Any]:
        """Complete the files of a run that is closed; return what is in ``summary.json``."""

    @abstractmethod
    def next_settings(self, output: str) -> RunSettings:
        """Return the settings of a run that begins when this one has ended."""

    def discard(self) -> None:
        """Leave no file behind that was not kept."""
        if self._files is not None:
            self._files.discard()


class EstimatorSession(Session):
    """
    An estimator between its inputs and outputs.

    Parameters
    ----------
    settings : what the user chose
    folder : where the files of the run go, None for no files
    force : whether files of an earlier run may be replaced
    is_wanted : whether somebody listens to a topic

    Attributes
    ----------
    is_restored : whether it goes on from a checkpoint

    """

    outputs: Outputs
    diagnostics: Diagnostics

    def __init__(
        self, settings: RunSettings, folder: Path | None, force: bool = False,
        is_wanted: Callable[[str], bool] = lambda _: True,
    ) -> None:
        self._is_wanted = is_wanted
        self.settings = settings
        self._prior = prior_map(settings.node.prior_landmarks)
        self.is_restored = _has_checkpoint(settings.node)
        if self.is_restored:
            self.estimator, self.inputs = checkpoint.load(
                Path(settings.node.restore), settings, self._prior)
        else:
            self.estimator = Estimator(settings.estimation, self._prior)
            self.inputs = Inputs(
                self.estimator, resets_on_time_jump=settings.node.on_time_jump == 'reset')
        self.consumer = self.estimator
        self.outputs = Outputs(self.estimator, self.inputs, settings.node)
        self.diagnostics = Diagnostics(self.estimator, self.inputs, settings.node.clock_limit)
        self._files = None if folder is None else Files(folder, self.estimator.robots, force)

    def take(self) -> Iterator[Publication]:
        """Do the steps that are due; yield what is to be published of them."""
        yield from self._publications(self.estimator.take())

    def release(self) -> Iterator[Publication]:
        """Finish all steps without waiting for more input."""
        yield from self._publications(self.estimator.release())

    def close(self) -> Iterator[Publication]:
        """Finish the last steps: the input has ended."""
        self.inputs.close()
        yield from self._publications(self.estimator.close())

    def keep(self) -> dict[str, Any]:
        """Complete the files of a run that is closed; return what is in ``summary.json``."""
        told = {**summary(self.estimator, self.inputs, self.settings), **self.source}
        if self._files is not None:
            shared_ids = self.settings.estimation.shared_landmark_ids
            self._files.keep(map_estimates(self.estimator), shared_ids, summary=told)
        return told

    def change_team(self, names: object) -> None:
        """
        Let robots come and leave: the team is another from now on.

        Parameters
        ----------
        names : the new value of the parameter ``robots``

        Raises
        ------
        UsageError
            It names no team, or a robot has to stay.

        """
        before = self.estimator.robots
        robots = parameters.changed_team(self.settings.estimation, before, names)
        here = [robot.name for robot in robots]
        leaving = [name for name in before if name not in here]
        for name in leaving:
            if not self.estimator.groups.may_leave(name):
                raise UsageError(
                    f'the anchor {name!r} cannot leave before it has seen a landmark: keep it in'
                    ' robots until then')
        if self._files is not None:
            self._files.begin(here)
        for name in leaving:
            self.inputs.forget(name)
            self.outputs.forget(name)
        self.estimator.change_team(robots)

    def next_settings(self, output: str) -> RunSettings:
        """Return the settings of a run that begins when this one has ended, with its team."""
        settings, robots = self.settings.estimation, self.estimator.robots
        anchor = settings.anchor if settings.anchor in {'', *robots} else next(iter(robots))
        return RunSettings(
            replace(settings, robots=tuple(robots.values()), anchor=anchor),
            replace(self.settings.node, output=output, restore=''))

    def save(self) -> Path:
        """
        Write the checkpoint and return its path.

        Raises
        ------
        UserError
            It cannot be written, or the settings name none.

        """
        path = self.settings.node.checkpoint
        if not path:
            raise UsageError("there is no file to save to: give the parameter 'checkpoint'")
        checkpoint.save(Path(path), self.estimator, self.inputs, self._prior)
        return Path(path)

    def _publications(self, results: Iterable[StepResult]) -> Iterator[Publication]:
        begin = perf_counter()
        for result in results:
            if self._files is not None:
                self._files.write(result.poses)
            yield from self.outputs.of_step(result, self._is_wanted)
            end = perf_counter()
            self.diagnostics.step_times.append(end - begin)
            begin = end
        yield from rejections(self.estimator.statistics)


def _has_checkpoint(node: NodeSettings) -> bool:
    """Return whether a run goes on: what it saves itself may not be there at its first start."""
    is_its_own = node.restore == node.checkpoint
    return bool(node.restore) and (not is_its_own or Path(node.restore).exists())
