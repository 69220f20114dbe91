# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Exchange of logs with the robots in reach: messages to be sent, and use of received ones.

Every robot sends a list of its blocks in each period (*hello*). A robot that has blocks which
another one lacks sends them, with a limit on the bytes per second. A hello is thereby request and
acknowledgement; every message may be lost, repeated or late. All messages go to all robots in
reach, so that one block serves each of them.

A block is sent again if a hello that came a round trip after it still lacks it. Hellos echo the
stamps of the hellos of others, by which each robot measures the round trip to every other one.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, field, replace

from fej_slam_ros.core.peers.logs import BlockKey, is_of_team, Knowledge, LogName
from fej_slam_ros.core.peers.messages import (
    BlockMessage, echo_key, ECHO_MODULUS, Hello, hellos, Message, MessageRejectedError,
    MessageRejection, read, write)
from fej_slam_ros.core.peers.team_logs import TeamLogs
from fej_slam_ros.core.records import NS

#: Time without a message after which a robot is out of reach, in periods.
REACH_PERIODS = 4
#: Shortest time [ns] after which a hello that still lacks a block shows that it was lost; less
#: makes no difference, as hellos come at their period.
MIN_WAIT = NS // 5
#: Longest round trip [ns] that is accepted, which is also assumed before any is known: that of a
#: satellite link with a queue.
MAX_ROUND_TRIP = 10 * NS
#: Time [ns] by which a round trip may be longer than the measured ones before.
ROUND_TRIP_MARGIN = NS // 20
#: Divisor of the difference by which a shorter round trip than before counts. A longer one counts
#: at once, or every block would be sent again.
ROUND_TRIP_SMOOTHING = 4
#: Unit of times in echoes [ns].
MS = NS // 1000
#: Maximum number of logs in the hellos of a robot.
MAX_LOGS = 10_000
#: Longest time [ns] for which bytes that were not sent may be sent later.
MAX_SAVING = NS


@dataclass(frozen=True)
class ExchangeSettings:
    """Parameters of the exchange."""

    peers: frozenset[str]  #: names of the robots with which data are exchanged
    period: int = NS // 2  #: time between two hellos [ns]
    #: longest time in reach [ns] for which measurements wait, once for each robot, for rendezvous
    #: information of both
    information_first: int = 5 * NS
    rate: float = 100_000.0  #: maximum number of bytes of blocks sent per second


@dataclass(slots=True, eq=False)
class PeerState:
    """State of the exchange with another robot."""

    name: str
    last_message: int | None = None  #: time of its last message [ns]
    in_reach_since: int = 0  #: time of the first one since it came in reach [ns]
    run: int | None = None  #: its run by its newest hello
    hello: tuple[int, int] | None = None  #: time of its newest hello by its own clock and by ours
    round_trip: int | None = None  #: time to it and back [ns], None before it is measured
    #: time of its last hello about each log, and its blocks of the log
    known: dict[LogName, tuple[int, Knowledge]] = field(default_factory=dict)
    others: set[LogName] = field(default_factory=set)  #: its logs of unknown robots
    logs: int | None = None  #: number of its logs of known robots by its last hello
    waited: int = 0  #: time in which measurements waited for rendezvous information [ns]
    bytes_received: int = 0
    rejected: Counter[MessageRejection] = field(default_factory=Counter)

    def restart(self, run: int, now: int) -> None:
        """Begin another run of the robot at a time [ns]; it may have lost its logs."""
        self.run, self.hello, self.in_reach_since = run, None, now
        self.known.clear()
        self.others.clear()

    def receive_hello(self, stamp: int, now: int, longest_delay: int) -> int | None:
        """Return when hellos of a stamp came first; None if newer ones have overtaken this one."""
        if self.hello is not None:
            newest, heard = self.hello
            if newest - longest_delay < stamp < newest:
                return None
            if stamp == newest:
                return heard
        # It is newer, or the clock of the robot has gone back.
        self.hello = stamp, now
        return now

    def add_round_trip(self, measured: int) -> None:
        """Use a measured round trip [ns], unless a clock has changed in it."""
        if measured > MAX_ROUND_TRIP:
            return
        if self.round_trip is None or measured > self.round_trip:
            self.round_trip = measured
        else:
            self.round_trip -= (self.round_trip - measured) // ROUND_TRIP_SMOOTHING

    def wait(self) -> int:
        """Return the time [ns] after which a hello that lacks a block shows that it was lost."""
        if self.round_trip is None:
            return MAX_ROUND_TRIP
        return max(self.round_trip + ROUND_TRIP_MARGIN, MIN_WAIT)

    def forget(self, oldest: int) -> None:
        """
        Forget the logs that it has not listed since a time [ns]: it may have restarted without.

        Each hello may be lost, and may have a part of the list only.

        """
        self.known = {log: known for log, known in self.known.items() if known[0] >= oldest}

    def has_listed_all(self) -> bool:
        """Return whether its hellos have named all its logs."""
        return self.logs is not None and self.logs <= len(self.known)


class PeerExchange:
    """
    The exchange of logs of one robot with all others in reach.

    Times are passed in, as the core has no clock; they need not agree with those of other robots.

    """

    def __init__(self, logs: TeamLogs, settings: ExchangeSettings) -> None:
        self.logs, self.settings = logs, settings
        self.peers = {name: PeerState(name) for name in sorted(settings.peers)}
        #: bytes_sent, messages_sent: by kind, hello or block
        self.bytes_sent: Counter[str] = Counter()
        self.messages_sent: Counter[str] = Counter()
        #: rejected messages that belong to no peer, by reason
        self.rejected_unread: Counter[MessageRejection] = Counter()
        #: blocks that are not sent yet, set by the caller
        self.held_back: Collection[BlockKey] = frozenset()
        self._next_hello: int | None = None
        self._sent_at: dict[BlockKey, int] = {}
        self._saved, self._last = 0.0, 0

    def change_peers(self, names: Iterable[str]) -> None:
        """Exchange data with some robots, and with no others, from now on."""
        self.peers = {name: self.peers.get(name) or PeerState(name) for name in sorted(names)}
        for peer in self.peers.values():
            # The next hellos list the logs that were unknown so far.
            peer.others.clear()
            peer.logs = None

    def receive(self, data: bytes, now: int) -> MessageRejection | None:
        """Use a message; return the reason if it is rejected."""
        rejections = self.rejected_unread
        try:
            message = read(data)
            peer = self._sender(message)
            if peer is not None:
                rejections = peer.rejected
                peer.bytes_received += len(data)
                self._receive(peer, message, now)
        except MessageRejectedError as rejected:
            rejections[rejected.reason] += 1
            return rejected.reason
        return None

    def due(self, now: int) -> Iterator[bytes]:
        """Yield the messages to be sent at a time [ns]."""
        if self._next_hello is None or now >= self._next_hello:
            self._next_hello = now + self.settings.period
            self.logs.flush()
            self._forget_sent(now)
            for data in hellos(
                    self.logs.robot, self.logs.run, now, self._known(), self._echoes(now)):
                yield self._counted('hello', data)
        elapsed, self._last = min(now - self._last, MAX_SAVING), now
        rate = self.settings.rate / NS
        self._saved = min(self._saved + rate * elapsed, rate * MAX_SAVING)
        for peer in self._peers_in_reach(now):
            peer.waited += elapsed
        for name, run, number in self._lacking(now):
            if self._saved <= 0.0:
                return
            block = self.logs.logs[name].block(number)
            data = write(BlockMessage(self.logs.robot, block))
            self._saved -= len(data)
            self._sent_at[name, run, number] = now
            yield self._counted('block', data)

    def in_reach(self, now: int) -> list[str]:
        """Return the names of the robots of which a message was received lately."""
        return [peer.name for peer in self._peers_in_reach(now)]

    def is_complete(self, now: int) -> bool:
        """Return whether all robots in reach have all that this one has, by their hellos."""
        return all(
            peer.has_listed_all() and not any(self._missing(peer, waits=False))
            for peer in self._peers_in_reach(now))

    def _peers_in_reach(self, now: int) -> list[PeerState]:
        return [peer for peer in self.peers.values() if self._is_in_reach(peer, now)]

    def _is_in_reach(self, peer: PeerState, now: int) -> bool:
        limit = REACH_PERIODS * self.settings.period
        return peer.last_message is not None and now - peer.last_message <= limit

    def _sender(self, message: Message) -> PeerState | None:
        """Return the robot that has sent a message, None if it is an own one that comes back."""
        if message.sender == self.logs.robot:
            if isinstance(message, Hello) and message.run != self.logs.run:
                raise MessageRejectedError(MessageRejection.SAME_NAME)
            return None
        if message.sender not in self.peers:
            raise MessageRejectedError(MessageRejection.UNKNOWN_ROBOT)
        return self.peers[message.sender]

    def _receive(self, peer: PeerState, message: Message, now: int) -> None:
        if not self._is_in_reach(peer, now):
            peer.in_reach_since, peer.hello = now, None
        peer.last_message = now
        if isinstance(message, Hello):
            self._receive_hello(peer, message, now)
        else:
            self._receive_block(message, now)

    def _receive_hello(self, peer: PeerState, hello: Hello, now: int) -> None:
        if peer.run is not None and hello.run < peer.run:
            raise MessageRejectedError(MessageRejection.OLD_RUN)
        if hello.run != peer.run:
            peer.restart(hello.run, now)
        heard = peer.receive_hello(hello.stamp, now, REACH_PERIODS * self.settings.period)
        if heard is None:
            return
        echo = hello.echoes.get(echo_key(self.logs.robot))
        if echo is not None:
            # Both times are rounded down: one more is not negative where clocks differ in rate.
            peer.add_round_trip((now // MS + 1 - echo) % ECHO_MODULUS * MS)
        self._receive_list(peer, hello, heard)

    def _receive_list(self, peer: PeerState, hello: Hello, heard: int) -> None:
        """Use the list of logs in a hello that was received at a time [ns]."""
        # Logs of former peers are still known, and given to robots that lack them.
        of_team = {
            entry.log: (heard, entry) for entry in hello.known
            if self._is_wanted(entry.log) or entry.log in self.logs.logs}
        peer.forget(heard - REACH_PERIODS * self.settings.period)
        peer.known |= of_team
        # It may list logs of robots that are unknown here.
        peer.others |= {entry.log for entry in hello.known if entry.log not in of_team}
        peer.logs = hello.logs - len(peer.others)
        if len(peer.others) > MAX_LOGS:
            peer.others.clear()
            raise MessageRejectedError(MessageRejection.BAD_CONTENT)
        _, own = of_team.get(LogName(self.logs.robot), (heard, None))
        if own is not None and not self.logs.has_written(own):
            raise MessageRejectedError(MessageRejection.SAME_NAME)

    def _receive_block(self, message: BlockMessage, now: int) -> None:
        block = message.block
        if not self._is_wanted(block.log):
            raise MessageRejectedError(MessageRejection.UNKNOWN_ROBOT)
        self.logs.add(block)
        # All robots in reach have received it, too: this one need not send it.
        self._sent_at[block.log, block.run, block.number] = now

    def _echoes(self, now: int) -> dict[int, int]:
        """Return the time by the clock of each robot in reach, late by the delay from there."""
        return {
            echo_key(peer.name): (peer.hello[0] + now - peer.hello[1]) // MS % ECHO_MODULUS
            for peer in self._peers_in_reach(now) if peer.hello is not None}

    def _is_wanted(self, name: LogName) -> bool:
        """Return whether a log is of the present team."""
        return is_of_team(name, {self.logs.robot, *self.peers})

    def _known(self) -> list[Knowledge]:
        """Return the knowledge of all logs; those of former peers count as ended."""
        return [
            log.knowledge() if self._is_wanted(name) else replace(log.knowledge(), is_ended=True)
            for name, log in self.logs.logs.items()]

    def _forget_sent(self, now: int) -> None:
        """
        Forget when blocks were sent, so that they are sent again to robots that do not list them.

        A robot that does not list a log has lost all of it, or does not want it: it is offered the
        first block again, and the others when it has that.

        """
        limit = REACH_PERIODS * self.settings.period + max(
            (peer.round_trip or 0 for peer in self._peers_in_reach(now)), default=0)
        self._sent_at = {
            (name, run, number): at for (name, run, number), at in self._sent_at.items()
            if now - at <= limit or (number > 0 and self.logs.logs[name].run == run)}

    def _lacking(self, now: int) -> list[BlockKey]:
        """Return the blocks that a robot in reach lacks, in the order in which they are sent."""
        lacking = {
            block for peer in self._peers_in_reach(now)
            for block, heard in self._missing(peer, self._waits(peer))
            if (sent_at := self._sent_at.get(block)) is None or heard - sent_at >= peer.wait()}
        return sorted(lacking.difference(self.held_back), key=self._priority)

    def _missing(self, peer: PeerState, waits: bool) -> Iterator[tuple[BlockKey, int]]:
        """
        Yield the blocks that a robot lacks, and when it reported so [ns].

        Measurements are left out while they wait for rendezvous information.

        """
        if not peer.has_listed_all():
            return
        for log in self.logs.logs.values():
            about = log.name.about
            if log.name.author != peer.name and (about == peer.name or not (about or waits)):
                heard, known = peer.known.get(log.name, (peer.in_reach_since, None))
                for number in log.missing(known):
                    yield (log.name, log.run, number), heard

    def _waits(self, peer: PeerState) -> bool:
        """Return whether measurements for a robot wait for rendezvous information."""
        return peer.waited < self.settings.information_first and not self._has_information(peer)

    def _has_information(self, peer: PeerState) -> bool:
        """Return whether both robots have the rendezvous information of each other."""
        ours, theirs = LogName(self.logs.robot, peer.name), LogName(peer.name, self.logs.robot)
        sent, received = self.logs.logs.get(ours), self.logs.logs.get(theirs)
        _, known = peer.known.get(ours, (0, None))
        _, written = peer.known.get(theirs, (0, None))
        return (
            sent is not None and known is not None and next(sent.missing(known), None) is None
            # Hellos of its author say how many blocks the information has.
            and received is not None and written is not None
            and len(received.blocks) >= written.count)

    def _priority(self, block: BlockKey) -> tuple[bool, bool, LogName, int, int]:
        """Return the sort key: rendezvous information, own measurements, the oldest first."""
        name, run, number = block
        return not name.about, name.author != self.logs.robot, name, run, number

    def _counted(self, kind: str, data: bytes) -> bytes:
        self.bytes_sent[kind] += len(data)
        self.messages_sent[kind] += 1
        return data
