# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When the rendezvous of a robot with others is computed, as more of it becomes known."""

from typing import NamedTuple

from fej_slam_ros.core.peers.exchange import PeerExchange
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.peer_smoother import PeerSmoother
from fej_slam_ros.core.records import NS

#: Shortest time between two computations of a rendezvous by further own observations [ns].
RENDEZVOUS_PERIOD = NS


class KnownRendezvous(NamedTuple):
    """What is known of the rendezvous with another robot."""

    observations: int = 0  #: number of own observations of the other
    run: int = 0  #: run of the information of the other, 0 without any
    blocks: int = 0  #: number of blocks of that information


class LastComputation(NamedTuple):
    """The last computation of the rendezvous with another robot."""

    time: int = -RENDEZVOUS_PERIOD  #: of its end [ns]; if it failed, of the end of the pause after
    known: KnownRendezvous = KnownRendezvous()  #: what it used


class RendezvousSchedule:
    """Decides which rendezvous is computed next, while maps are not joined."""

    def __init__(self, team: PeerSmoother, exchange: PeerExchange) -> None:
        self._team = team
        self._exchange = exchange
        self._last: dict[str, LastComputation] = {}

    def due(self, now: int) -> str | None:
        """Return a robot in reach that has not joined, if more of its rendezvous is known."""
        for peer in self._exchange.in_reach(now):
            last, known = self._last.get(peer, LastComputation()), self._known(peer)
            if now < last.time or self._team.solution.has_joined([self._team.robot, peer]):
                continue
            # A run of the other's information comes once; its blocks and own observations go on.
            if known.run != last.known.run or (
                    known != last.known and now - last.time >= RENDEZVOUS_PERIOD):
                return peer
        return None

    def begin(self, peer: str, now: int) -> None:
        """Record that the rendezvous with a robot is computed from all that is known."""
        self._last[peer] = LastComputation(now, self._known(peer))

    def end(self, peer: str, time: int) -> None:
        """Record the end of the computation [ns], or that of the pause if it has failed."""
        self._last[peer] = self._last[peer]._replace(time=time)

    def _known(self, peer: str) -> KnownRendezvous:
        observations = self._team.observed[peer]
        log = self._team.logs.logs.get(LogName(peer, self._team.robot))
        return KnownRendezvous(observations) if log is None else KnownRendezvous(
            observations, log.run, len(log.blocks))
