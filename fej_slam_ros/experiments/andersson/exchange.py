# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two robots of an experiment that exchange their logs over a bad link, with the bytes sent."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.peers.exchange import ExchangeSettings, PeerExchange
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.rendezvous_window import (
    contents, rendezvous_task, RendezvousResult, solve_rendezvous)
from fej_slam_ros.core.peers.team_logs import TeamLogs
from fej_slam_ros.core.records import NS, Odometry, RobotScan, Scan
from fej_slam_ros.core.settings import numbered_robots, Settings
from fej_slam_ros.experiments.andersson.experiment import Scene

#: Share of the messages that the link loses, and period in which messages are sent [ns].
LOSS, TICK = 0.2, NS // 10
#: Longest time of an exchange, in periods.
MAX_EXCHANGE_PERIODS = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Exchanged:
    """An exchange between P and Q."""

    rendezvous: RendezvousResult  #: what P knows of Q by the rendezvous information
    bytes_to_align: int  #: sent by both robots until then
    bytes_in_all: int  #: sent until both had both logs


def exchange(scene: Scene, seed: int) -> Exchanged | None:
    """Return the exchange of two robots after their drive; None if they are not aligned."""
    names, rng = scene.truth.robots, np.random.default_rng(seed)
    settings = Settings(numbered_robots(names), names[0], shared_landmark_ids=False)
    logs = {robot.name: TeamLogs(robot.name, 1, robot) for robot in settings.robots}
    for record in scene.records:
        if isinstance(record, (Odometry, Scan, RobotScan)):
            logs[record.robot].record(record)
    robots = {
        name: PeerExchange(logs[name], ExchangeSettings(frozenset(names) - {name}))
        for name in names}
    results: dict[str, RendezvousResult] = {}
    bytes_to_align = 0
    for now in range(TICK, MAX_EXCHANGE_PERIODS * TICK, TICK):
        _pass_on(robots, now, rng)
        for name, other in (names, names[::-1]):
            if name not in results and robots[name].in_reach(now):
                _share_rendezvous(logs[name], settings, other, results)
        if names[0] in results and not bytes_to_align:
            bytes_to_align = _bytes_sent(robots)
        if all(robot.in_reach(now) and robot.is_complete(now) for robot in robots.values()):
            break
    if names[0] not in results:
        return None
    return Exchanged(results[names[0]], bytes_to_align, _bytes_sent(robots))


def _pass_on(robots: Mapping[str, PeerExchange], now: int, rng: np.random.Generator) -> None:
    """Deliver the messages that are due, but for those that are lost."""
    for name, sender in robots.items():
        for message in sender.due(now):
            for other, receiver in robots.items():
                if other != name and rng.random() >= LOSS:
                    receiver.receive(message, now)


def _share_rendezvous(
    logs: TeamLogs, settings: Settings, other: str, results: dict[str, RendezvousResult]
) -> None:
    """Let a robot publish its information about a rendezvous, and add the alignment."""
    result = solve_rendezvous(rendezvous_task(logs, settings, other))
    if result is not None:
        logs.publish(LogName(logs.robot, other), contents(result.message))
        if not isinstance(result.alignment, JoinFailure):
            results[logs.robot] = result


def _bytes_sent(robots: Mapping[str, PeerExchange]) -> int:
    return sum(robot.bytes_sent.total() for robot in robots.values())
