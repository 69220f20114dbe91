# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics and log of a smoother that exchanges measurements with others."""

from collections import Counter
from collections.abc import Iterator, Mapping
from time import monotonic_ns

from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.peers.exchange import PeerExchange
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.messages import MessageRejection
from fej_slam_ros.core.peers.peer_smoother import PeerSmoother
from fej_slam_ros.core.peers.rendezvous_window import RendezvousResult
from fej_slam_ros.core.sentences import reasons_in_words
from fej_slam_ros.ros.messages import Message, outgoing
from fej_slam_ros.ros.parameters import NodeSettings
from fej_slam_ros.ros.session.faults import Fault, Level
from fej_slam_ros.ros.session.inputs import Inputs
from fej_slam_ros.ros.session.log_lines import LogSeverity
from fej_slam_ros.ros.session.run_log import Missing
from fej_slam_ros.ros.session.smoother_reports import SmootherDiagnostics, SmootherLog

#: What users have to know of each rejection.
EXPLANATIONS = {
    MessageRejection.TRUNCATED: 'it is incomplete',
    MessageRejection.OTHER_VERSION: 'it is not of this version of fej_slam_ros',
    MessageRejection.CORRUPT: 'its checksum is wrong',
    MessageRejection.UNKNOWN_ROBOT: 'it is of a robot that is not in peers',
    MessageRejection.SAME_NAME:
        'another robot has the name of this one, or its exchange_file was deleted',
    MessageRejection.OLD_RUN: 'it is of an earlier run of its author',
    MessageRejection.TOO_FAR_AHEAD: 'what comes before it is missing',
    MessageRejection.CONTRADICTION: 'it differs from what was received before',
    MessageRejection.BAD_CONTENT: 'it contains no possible measurements',
    MessageRejection.OTHER_SHARED_LANDMARK_IDS: 'its author has another shared_landmark_ids',
    MessageRejection.OTHER_KEYFRAME_DISTANCE: 'its author has another keyframe_distance',
}


class PeerDiagnostics(SmootherDiagnostics):
    """Reports on the own robot, and on what has been exchanged with others."""

    _consumer: PeerSmoother

    def __init__(
        self, team: PeerSmoother, inputs: Inputs, settings: NodeSettings, exchange: PeerExchange
    ) -> None:
        super().__init__(team, inputs, settings)
        self._exchange = exchange
        # Rejected messages of each robot at the last report.
        self._rejected_before: dict[str, Counter[MessageRejection]] = {}

    def _with_faults(self, robot: str, now: int, level: Level, message: str) -> tuple[Level, str]:
        """Add the conditions of the input, or for another robot whether it is in reach."""
        if robot == self._consumer.robot:
            return super()._with_faults(robot, now, level, message)
        in_reach = robot in self._exchange.in_reach(monotonic_ns())
        total = self._exchange.peers[robot].rejected
        rejected = total - self._rejected_before.get(robot, Counter())
        self._rejected_before[robot] = total.copy()
        reach = 'in reach' if in_reach else 'out of reach'
        if not rejected:
            return level, f'{message}; {reach}'
        return max(level, Level.WARN), (
            f'{message}; {reach}; rejected: {reasons_in_words(rejected)}')

    def _no_input(self, now: int) -> Fault | None:
        """Return the condition that the own robot sends no odometry, None if it does."""
        own_input = self._input_of(self._consumer.robot, now)
        if not own_input.flow('odom').received:
            return Fault(Level.WARN, 'no odometry received')
        if own_input.has_stopped('odom'):
            return Fault(Level.STALE, 'the odometry has stopped')
        return None

    def _values_of(self, robot: str) -> dict[str, object]:
        values = super()._values_of(robot)
        peer = self._exchange.peers.get(robot)
        if peer is None:
            return values
        result = self._consumer.rendezvous_results.get(robot)
        aligned = '' if result is None else (
            result.alignment.reason if isinstance(result.alignment, JoinFailure) else 'yes')
        log = self._consumer.logs.logs.get(LogName(robot))
        return {
            **values, 'blocks': 0 if log is None else len(log.blocks),
            'bytes_received': peer.bytes_received, 'aligned_by_rendezvous': aligned}

    def _overall(self, now: int, at_rest: bool) -> Message:
        status = super()._overall(now, at_rest)
        sent, unread = self._exchange.bytes_sent, self._exchange.rejected_unread
        status.values += outgoing.key_values({
            'exchange_bytes_hello': sent['hello'], 'exchange_bytes_blocks': sent['block'],
            'exchange_messages': self._exchange.messages_sent.total(),
            'exchange_bytes_known': self._consumer.logs.size(),
            **{f'exchange_{reason.value}': count for reason, count in unread.items()}})
        return status


class PeerLog(SmootherLog):
    """The log of one run: who is in reach, what is known of their poses, what is rejected."""

    def __init__(self, team: PeerSmoother, inputs: Inputs, exchange: PeerExchange) -> None:
        super().__init__(team, inputs)
        self._robot = team.robot
        self._exchange = exchange
        self._in_reach: set[str] = set()
        self._aligned: set[str] = set()
        self._failed: set[str] = set()
        self._rejected: set[tuple[str, MessageRejection]] = set()

    def check(self, now: int) -> None:
        """Add the lines of input that stopped, of robots that come and go, and of rejections."""
        super().check(now)
        in_reach = {*self._exchange.in_reach(monotonic_ns())}
        for name in sorted(in_reach - self._in_reach):
            self.add(LogSeverity.INFO, f'{name} is in reach')
        for name in sorted(self._in_reach - in_reach):
            self.add(LogSeverity.INFO, f'{name} is out of reach')
        self._in_reach = in_reach
        rejected = {'': self._exchange.rejected_unread} | {
            name: peer.rejected for name, peer in self._exchange.peers.items()}
        for name, reasons in rejected.items():
            for reason in reasons:
                if (name, reason) not in self._rejected:
                    self._rejected.add((name, reason))
                    sender = name or 'an unknown sender'
                    self.add(LogSeverity.WARN, (
                        f'a message of {sender} is rejected: {EXPLANATIONS[reason]}'))

    def add_rendezvous(self, peer: str, result: RendezvousResult) -> None:
        """Add a line when a rendezvous first aligns the map of another robot."""
        if peer not in self._aligned and not isinstance(result.alignment, JoinFailure):
            self._aligned.add(peer)
            self.add(LogSeverity.INFO, (
                f'{peer}: the pose of its map is known by the rendezvous, before any of the map'))

    def add_failed_rendezvous(self, peer: str, error: str) -> None:
        """Add a line when the rendezvous with another robot cannot be computed at first."""
        if peer not in self._failed:
            self._failed.add(peer)
            self.add(LogSeverity.WARN, f'{peer} is not aligned by the rendezvous: {error}')

    def _missing_odometry(self, faults: Mapping[str, str]) -> Iterator[Missing]:
        return (
            missing for missing in super()._missing_odometry(faults)
            if missing.what == f'odometry of {self._robot}')
