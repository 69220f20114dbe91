# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots that exchange their logs over a simulated radio, without sockets and clocks."""

from collections import Counter
from dataclasses import replace

import numpy as np

from fej_slam_ros.core.peers.exchange import ExchangeSettings, PeerExchange
from fej_slam_ros.core.peers.logs import LogName
from fej_slam_ros.core.peers.rendezvous_window import contents, rendezvous_task, solve_rendezvous
from fej_slam_ros.core.peers.team_logs import TeamLogs
from fej_slam_ros.core.peers.union import smoothed_union, UnionTask
from fej_slam_ros.core.records import NS, Odometry, RobotScan, Scan
from fej_slam_ros.core.settings import RobotSettings, Settings
from helpers.csam import smoothed

#: Time between two calls of an exchange.
TICK = NS // 10


def team_settings(names, anchor='', shared=True):
    robots = tuple(RobotSettings(name, k) for k, name in enumerate(sorted(names), start=1))
    return Settings(robots, anchor, shared_landmark_ids=shared)


def is_measurement(record):
    return isinstance(record, (Odometry, Scan, RobotScan))


def central(records, settings):
    """Return the central smoother of measurements."""
    measurements = sorted(filter(is_measurement, records), key=lambda record: record.stamp)
    return smoothed(measurements, settings)[0]


class Robot:
    """One robot: its logs and its exchange; `settings` is that of the team."""

    def __init__(self, name, settings, run=1, **options):
        # Its own name is the first, as in the node.
        own_first = tuple(sorted(settings.robots, key=lambda robot: robot.name != name))
        self.settings = replace(settings, anchor=name, robots=own_first)
        noise = next(robot for robot in settings.robots if robot.name == name)
        peers = frozenset(robot.name for robot in settings.robots) - {name}
        self.logs = TeamLogs(name, run, noise)
        self.exchange = PeerExchange(self.logs, ExchangeSettings(peers, **options))

    def union(self):
        """Return the smoother of all that the robot knows."""
        contents_of = {name: self.logs.contents(name) for name in self.logs.robots}
        return smoothed_union(UnionTask(self.settings, contents_of, self.logs.noise, 10**9))

    def share_rendezvous(self, peer):
        """Send information about a rendezvous; return the alignment."""
        result = solve_rendezvous(rendezvous_task(self.logs, self.settings, peer))
        if result is None:
            return None
        self.logs.publish(LogName(self.logs.robot, peer), contents(result.message))
        return result


class Radio:
    """
    Delivers each message to the robots in reach of its sender, with losses and repetitions.

    Parameters
    ----------
    robots : by name
    rng : of losses
    loss, repeated : probability that a message does not arrive, or arrives again later
    damage : returns the bytes that arrive of a message
    delay : time from sending a message to its arrival [s]

    """

    def __init__(self, robots, rng, loss=0.0, repeated=0.0, damage=lambda data: data, delay=0.0):
        self.robots, self.now = robots, 0
        self._damage, self._delay = damage, round(delay * NS)
        self.rejected, self.bytes = Counter(), Counter()
        self._rng, self._loss, self._repeated = rng, loss, repeated
        self._later = []

    def run(self, duration, is_in_reach=lambda a, b: True):
        """Let time pass, by `duration` seconds."""
        for _ in range(round(duration * NS / TICK)):
            self.now += TICK
            later, self._later = self._later, []
            for arrival, receiver, data in later:
                if arrival <= self.now:
                    self._deliver(receiver, data)
                else:
                    self._later.append((arrival, receiver, data))
            for sender, robot in self.robots.items():
                for data in robot.exchange.due(self.now):
                    self.bytes[sender] += len(data)
                    for receiver in self.robots:
                        if receiver != sender and is_in_reach(sender, receiver):
                            self._send(receiver, data)

    def _send(self, receiver, data):
        if self._rng.random() < self._repeated:
            self._later.append((self.now + self._delay, receiver, data))
        if self._rng.random() < self._loss:
            return
        if self._delay:
            self._later.append((self.now + self._delay, receiver, data))
        else:
            self._deliver(receiver, data)

    def _deliver(self, receiver, data):
        reason = self.robots[receiver].exchange.receive(self._damage(data), self.now)
        if reason is not None:
            self.rejected[reason] += 1


def poses_in_frame_of(team, robot):
    """Return all poses of all robots, in the frame of the first pose of one of them."""
    first = team.trajectories[robot].poses()[0]
    c, s = np.cos(first[2]), np.sin(first[2])
    turned = {}
    for name, trajectory in team.trajectories.items():
        moved = trajectory.poses() - first
        turned[name] = np.column_stack([
            moved[:, :2] @ np.array([[c, -s], [s, c]]),
            np.arctan2(np.sin(moved[:, 2]), np.cos(moved[:, 2]))])
    return turned
