# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One run of the smoother of one robot that exchanges its measurements with others."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import monotonic_ns, time_ns
from types import MappingProxyType
from typing import Any

from fej_slam_ros.core.csam.team_smoother import TeamSmoother
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.peers.exchange import ExchangeSettings, PeerExchange
from fej_slam_ros.core.peers.logs import Block
from fej_slam_ros.core.peers.messages import MessageRejectedError
from fej_slam_ros.core.peers.peer_smoother import PeerSmoother
from fej_slam_ros.core.peers.rendezvous_window import (
    rendezvous_task, RendezvousResult, RendezvousTask, solve_rendezvous)
from fej_slam_ros.core.peers.team_logs import noise_of, TeamLogs, TeamParameters
from fej_slam_ros.core.peers.union import smoothed_union
from fej_slam_ros.core.records import NS
from fej_slam_ros.core.settings import NoiseSettings, Settings
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.files.exchange_file import ExchangeFile, LiveExchangeFile
from fej_slam_ros.ros.messages import decoded, outgoing, RawMessage
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.session.peer_reports import PeerDiagnostics, PeerLog
from fej_slam_ros.ros.session.rendezvous_schedule import RendezvousSchedule
from fej_slam_ros.ros.session.smoother_outputs import SmootherOutputs
from fej_slam_ros.ros.session.smoother_session import FAILURE_PAUSE, SmootherSession, Solving
from fej_slam_ros.ros.topic_types import (
    EXCHANGE_TOPIC, EXCHANGE_TYPE, expected_topics, SENT_TOPICS, SMOOTHED_TEAM_TYPES, TF_TYPE)

#: Number of new poses that a block of another robot counts as, for the decision to solve.
BLOCK_POSES = 10

#: Opens the file of the exchange of a robot.
ExchangeOpener = Callable[[Path, str], ExchangeFile | LiveExchangeFile]


class PeerInputs(Inputs):
    """The inputs of the own robot; those of others arrive in their logs."""

    robot_topics = SENT_TOPICS
    _consumer: PeerSmoother

    @property
    def topics(self) -> dict[str, str]:
        """Return the types of the topics to subscribe to."""
        own = expected_topics([self._consumer.robot], self.robot_topics)
        return own | {EXCHANGE_TOPIC: EXCHANGE_TYPE}

    @property
    def static_topics(self) -> dict[str, str]:
        return dict.fromkeys(self.frames.static_topics(self._consumer.robot), TF_TYPE)


class PeerOutputs(SmootherOutputs):
    """Results, and messages to other smoothers."""

    team_types = MappingProxyType({**SMOOTHED_TEAM_TYPES, EXCHANGE_TOPIC: EXCHANGE_TYPE})

    _consumer: PeerSmoother

    def of_rendezvous(self, peer: str, result: RendezvousResult) -> Iterator[Publication]:
        """Yield the pose of the map of another robot, if it is known by their rendezvous."""
        if not isinstance(result.alignment, JoinFailure):
            base = result.alignment.base_node
            frame = own_frame(self._consumer.robot)
            yield self.of_pose(
                PoseEstimate(peer, result.stamp, frame, base.pose, base.P), 'base_node')


class PeerSession(SmootherSession):
    """
    A smoother of one robot between its inputs, the messages of other smoothers, and its outputs.

    Parameters
    ----------
    open_exchange : opens the file of the exchange, which the caller closes
    arguments, options : as for `SmootherSession`

    """

    team: PeerSmoother
    outputs: PeerOutputs
    diagnostics: PeerDiagnostics
    log: PeerLog

    def __init__(self, *arguments: Any, open_exchange: ExchangeOpener, **options: Any) -> None:
        self._open_exchange = open_exchange
        self._file: ExchangeFile | LiveExchangeFile | None = None
        super().__init__(*arguments, **options)

    def _create(self, solve_every: int) -> None:
        settings, node = self.settings.estimation, self.settings.node
        self._settings_of_start = settings
        self.is_restored = False
        parameters.check_peer_files(node)
        own, *others = settings.robots
        logs = TeamLogs(own.name, time_ns(), own, TeamParameters(
            settings.shared_landmark_ids, settings.keyframe_distance))
        if node.exchange_file:
            self._file = self._open_exchange(Path(node.exchange_file), own.name)
            self._restore(self._file.blocks, logs, own)
        self._exchange = PeerExchange(logs, ExchangeSettings(
            frozenset(robot.name for robot in others), round(node.exchange_period * NS),
            rate=node.exchange_rate))
        self.consumer = self.team = PeerSmoother(settings, own.name, logs, solve_every)
        self.inputs = PeerInputs(self.team, node)
        self.outputs = PeerOutputs(self.team, self.inputs, node)
        self.diagnostics = PeerDiagnostics(self.team, self.inputs, node, self._exchange)
        self.log = PeerLog(self.team, self.inputs, self._exchange)
        self._rendezvous = RendezvousSchedule(self.team, self._exchange)
        # A rendezvous is followed by a solution, if there is anything new to solve.
        self._is_after_rendezvous = False
        self._store()

    def _restore(self, blocks: Sequence[Block], logs: TeamLogs, own: NoiseSettings) -> None:
        """Add what the file of the exchange has to the logs."""
        file = f'exchange_file {self.settings.node.exchange_file}'
        try:
            for block in blocks:
                logs.restore(block)
        except MessageRejectedError as rejected:
            if logs.robot in logs.differing:
                parameter = logs.differing[logs.robot]
                raise UserError(
                    f'{file} was written with another {parameter}: give the value it had, or move'
                    ' it away to begin a new run') from None
            raise UserError(
                f'{file} is damaged ({rejected}): move it away to begin a new run') from None
        if blocks and logs.noise[logs.robot] != noise_of(own):
            raise UserError(
                f'{file} was written with another noise of {logs.robot}: give the noise it had, or'
                ' move it away to begin a new run')

    def receive(self, message: RawMessage) -> Iterable[Publication]:
        """Add a message of the own robot or of another smoother."""
        if message.topic != EXCHANGE_TOPIC:
            return super().receive(message)
        content = decoded(message.raw, EXCHANGE_TYPE)
        self._exchange.receive(b'' if content is None else bytes(content.data), monotonic_ns())
        return ()

    def exchange(self) -> Iterator[Publication]:
        """Yield the messages that are due to be sent to other smoothers."""
        self._store()
        for data in self._exchange.due(monotonic_ns()):
            # A hello closes a block.
            self._store()
            yield EXCHANGE_TOPIC, outgoing.byte_array(data)

    def is_solution_due(self, new_poses: int) -> bool:
        """Return whether a rendezvous or the solution of all that is known is to be computed."""
        return (
            self._rendezvous.due(monotonic_ns()) is not None or super().is_solution_due(new_poses))

    def solving(self) -> Solving:
        """Return what computes the next rendezvous, else the solution of all that is known."""
        peer = self._rendezvous.due(monotonic_ns())
        if peer is None or (self._is_after_rendezvous and super().is_solution_due(1)):
            self._is_after_rendezvous = False
            return smoothed_union, self.team.union_task()
        self._is_after_rendezvous = True
        self._rendezvous.begin(peer, monotonic_ns())
        return _solved_rendezvous, rendezvous_task(self.team.logs, self.settings.estimation, peer)

    def final_solving(self) -> Solving:
        return smoothed_union, self.team.union_task()

    def adopt(self, solution: Any) -> Iterator[Publication]:
        """Adopt a rendezvous or a solution, and return its publications."""
        if isinstance(solution, TeamSmoother):
            self.team.adopt_union(solution)
            return self._adopted()
        peer, result = solution
        self._rendezvous.end(peer, monotonic_ns())
        if result is None or peer not in self.team.robots:
            return iter(())
        self.team.adopt_rendezvous(peer, result)
        self.log.add_rendezvous(peer, result)
        return self.outputs.of_rendezvous(peer, result)

    def adopt_finally(self, final: Any) -> Iterator[Publication]:
        self.team.adopt_finally(final)
        return self._adopted()

    def give_up(self, task: Any, error: str) -> None:
        """Report the error for which there is no rendezvous or no new solution."""
        if not isinstance(task, RendezvousTask):
            self._report_unsolved(task.logs, error)
            return
        self._rendezvous.end(task.peer, monotonic_ns() + FAILURE_PAUSE)
        if task.peer in self.team.robots:
            self.team.rendezvous_results[task.peer] = RendezvousResult(
                b'', JoinFailure(error), 0, None)
            self.log.add_failed_rendezvous(task.peer, error)

    def checkpoint_content(self) -> bytes:
        """Reject it: the file of the exchange has all measurements at any time."""
        raise UsageError(
            "a smoother with 'peers' has no checkpoints: it keeps all measurements in the file of"
            " the parameter 'exchange_file'")

    def change_team(self, names: object) -> None:
        """Exchange measurements with other robots from now on; the own one is the first."""
        estimation = self.settings.estimation
        robots = parameters.changed_peers(self._settings_of_start, self.team.robots, names)
        team = [robot.name for robot in robots]
        if self._files is not None:
            self._files.add_robots(team)
        self.team.change_team(robots)
        self._exchange.change_peers(team[1:])
        self.settings = replace(
            self.settings, estimation=replace(estimation, robots=tuple(robots)))

    def present_settings(self) -> Settings:
        return self.settings.estimation

    def close(self) -> Iterator[Publication]:
        yield from super().close()
        self.team.logs.flush()
        self._store()

    def _store(self) -> None:
        """Add new blocks to the file of the exchange, and count what is new of other robots."""
        blocks = self.team.logs.take_new_blocks()
        self.team.new_poses += sum(
            BLOCK_POSES for block in blocks
            if block.log.author != self.team.robot and not block.log.about)
        if self._file is not None:
            self._file.append(blocks)
            # Nothing is sent that a restarted process would not have.
            self._exchange.held_back = {
                (block.log, block.run, block.number) for block in self._file.waiting
                if block.log.author == self.team.robot}


def _solved_rendezvous(task: RendezvousTask) -> tuple[str, RendezvousResult | None]:
    """Return the result of a rendezvous, with the name of the other robot."""
    return task.peer, solve_rendezvous(task)
