# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The interface that the nodes and the offline commands drive: messages in, messages out."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from types import MappingProxyType
from typing import Any

import numpy as np

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.estimator import Estimator
from fej_slam_ros.core.pieces import between_pieces, EndedError
from fej_slam_ros.core.records import PosePrior, UNKNOWN_POSE_COVARIANCE
from fej_slam_ros.core.rejections import RejectionReason
from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.files.live_files import LiveFiles
from fej_slam_ros.ros.files.run_files import RunFiles
from fej_slam_ros.ros.messages import RawMessage
from fej_slam_ros.ros.parameters import NodeSettings, RunSettings
from fej_slam_ros.ros.session.diagnostics import Diagnostics
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import Outputs, Publication
from fej_slam_ros.ros.session.run_log import RunLog


#: Opens the files of a run; None if that is impossible and the run continues without them.
FilesOpener = Callable[..., RunFiles | LiveFiles | None]


class Session(ABC):
    """
    One run of the estimator or the smoother, live or from a bag.

    Parameters
    ----------
    settings : of the run
    folder : for the files of the run, None for no files
    force : whether files of an earlier run may be replaced; None: the user has no such choice
    open_files : opens the files

    Attributes
    ----------
    consumer : the estimator or smoother
    inputs, outputs : convert messages to records, and results to messages
    diagnostics : reports on the run
    log : one line for each event of the run
    source : origin of the messages, for ``summary.json``
    settings : of the run, those of estimation as at its start
    is_restored : whether the run continues from a checkpoint
    check_time : called during the computation of the state hash; raises EndedError to give it up

    """

    source: Mapping[str, Any] = MappingProxyType({})
    settings: RunSettings
    is_restored: bool
    consumer: Estimator | TeamSmoother
    inputs: Inputs
    outputs: Outputs[Any]
    diagnostics: Diagnostics[Any]
    log: RunLog[Any]
    check_time: Callable[[], None] = staticmethod(lambda: None)
    _files: RunFiles | LiveFiles | None

    def continue_from(self, earlier: 'Session') -> None:
        """Take over what an ended run received once, and its input since time jumped."""
        self.consumer.truth.landmarks.update(earlier.consumer.truth.landmarks)
        self.inputs.continue_from(earlier.inputs)

    def receive(self, message: RawMessage) -> Iterable[Publication]:
        """Add a message; return the publications that wait for no step."""
        self.inputs.receive(message)
        return ()

    def take(self, most: int | None = None) -> Iterator[Publication]:
        """Process the steps that are due, or at most `most`, and yield their publications."""
        if self.consumer.is_waiting and not self.consumer.statistics.rejections:
            return iter(())
        return self._publications(islice(self.consumer.take(), most))

    def release(self, most: int | None = None) -> Iterator[Publication]:
        """Process all steps, or at most `most`, without waiting for more input."""
        return self._publications(islice(self.consumer.release(), most))

    def close(self) -> Iterator[Publication]:
        """Process the last steps at the end of the input."""
        self.inputs.close()
        yield from self._publications(self.consumer.close())

    def state_hash(self) -> str | None:
        """Return the state hash; None if input was interrupted, or if the hash takes too long."""
        if self.consumer.statistics.total(RejectionReason.INTERRUPTED):
            # No other run can end in the same state.
            return None
        try:
            with between_pieces(self.check_time):
                return self.consumer.state_hash()
        except EndedError:
            return None

    def checkpoint_content(self) -> bytes:
        """Return the content of a checkpoint; raise a UsageError if there is no file for it."""
        if not self.settings.node.checkpoint:
            raise UsageError("there is no file to save to: give the parameter 'checkpoint'")
        return self._checkpoint_content()

    @abstractmethod
    def _checkpoint_content(self) -> bytes:
        """Return the content of a checkpoint of the run."""

    @abstractmethod
    def write_files(self) -> dict[str, Any]:
        """Complete the files of a closed run; return the content of ``summary.json``."""

    @abstractmethod
    def change_team(self, names: object) -> None:
        """Add and remove robots during the run, for a new value of the parameter ``robots``."""

    def relocalization(self, robot: str) -> PosePrior:
        """
        Return the unknown pose that makes a robot restart in a frame of its own.

        Its stamp is that of the newest odometry, so that the robot restarts at the same step
        however fast the messages are processed. A UsageError says why the robot cannot restart.

        """
        last_step = self._last_step_of(robot)
        newest = self.consumer.sequencer.newest_odometry(robot)
        return PosePrior(
            robot, last_step if newest is None else newest, np.zeros(3), UNKNOWN_POSE_COVARIANCE)

    @abstractmethod
    def _last_step_of(self, robot: str) -> int:
        """Return the stamp [ns] of the last step of a robot, or say why it cannot restart."""

    @abstractmethod
    def present_settings(self) -> Settings:
        """Return the settings of estimation at present, with the present team."""

    def next_settings(self, output: str) -> RunSettings:
        """Return the settings of a run that follows this one, with its present team."""
        settings, robots = self.present_settings(), self.consumer.robots
        anchor = settings.anchor if settings.anchor in {'', *robots} else next(iter(robots))
        placed = settings.initialpose_robot
        return self.settings.followed_by(
            replace(
                settings, anchor=anchor, initialpose_robot=placed if placed in robots else ''),
            replace(self.settings.node, output=output, restore=''))

    def change_node_settings(self, node: NodeSettings) -> None:
        """Use other settings of the node, of which only changeable parameters may differ."""
        self.settings = replace(self.settings, node=node)
        self.outputs.settings = self.diagnostics.settings = node

    def check(self, now: int | None) -> None:
        """Log stale robots and missing input at a time [ns]; it is None without a clock."""
        if now is not None:
            self.log.check(now)
        self.log.remind(None if now is None else self.diagnostics.input_faults(now))

    def discard_files(self) -> None:
        """Delete the files that are not complete."""
        if self._files is not None:
            self._files.discard()

    @abstractmethod
    def _publications(self, results: Iterator[Any]) -> Iterator[Publication]:
        """Yield the publications of results of the consumer, and of rejections."""
