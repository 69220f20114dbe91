# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Demonstration: a simulator and other nodes as processes over DDS, on this machine."""

from collections.abc import Mapping, Sequence
from pathlib import Path
import sys
from time import monotonic

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros.messages import deserialize
from fej_slam_ros.ros.messages.common import from_covariance, from_time
from fej_slam_ros.ros.nodes.child_processes import (
    check_alive, ChildProcesses, keep_to_this_machine)
from fej_slam_ros.ros.nodes.endpoints import message_class
from fej_slam_ros.ros.nodes.qos import reliable
from fej_slam_ros.ros.nodes.ros_process import ros
from fej_slam_ros.ros.topic_types import POSE_WITH_COVARIANCE

#: Time [s] without a pose after which the estimator has processed everything.
IDLE_TIME = 1.0
#: Period of the line on the terminal [s].
REFRESH_PERIOD = 0.25


def run_processes(parameters: Mapping[str, Path], robots: Sequence[str], duration: float) -> bool:
    """
    Run the nodes until the simulated world has ended; return False after an interrupt.

    Parameters
    ----------
    parameters : parameter file of each node, an estimator and a simulator among them
    robots : their names
    duration : of the simulated world [s]

    """
    keep_to_this_machine()
    with ros([]) as stopped, ChildProcesses() as processes:
        running = {
            node: processes.start(node, path) for node, path in parameters.items()
            if node != 'simulator'}
        view = _LiveView(robots, duration)
        # The simulator waits for one subscriber only.
        while not stopped.is_set() and not view.are_subscribed(len(running)):
            view.refresh()
            for node, process in running.items():
                check_alive(process, node)
        if stopped.is_set():
            return False
        simulator = processes.start('simulator', parameters['simulator'])
        while not stopped.is_set() and (simulator.poll() is None or view.is_moving()):
            view.refresh()
            if not stopped.is_set():
                for node, process in running.items():
                    check_alive(process, node)
        view.close()
        if not stopped.is_set() and simulator.wait() != 0:
            raise UserError(f'the simulator failed with status {simulator.returncode}')
        # The estimator last, which gets what others still send.
        for process in sorted(running.values(), key=lambda p: p is running['estimator']):
            processes.end(process)
        return not stopped.is_set()


class _LiveView:
    """A line on the terminal with the estimated positions of the robots."""

    def __init__(self, robots: Sequence[str], duration: float) -> None:
        self._robots = robots
        self._duration = duration
        self._poses: dict[str, str] = {}
        self._time = 0.0
        self._last = monotonic()
        self._drawn = 0.0
        self._node = Node('demo')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        for name in robots:
            self._subscribe(name)

    def refresh(self) -> None:
        """Receive poses for a moment and update the line."""
        self._executor.spin_once(timeout_sec=REFRESH_PERIOD)
        if sys.stdout.isatty() and monotonic() - self._drawn > REFRESH_PERIOD:
            self._drawn = monotonic()
            poses = '  '.join(f'{name} {self._poses[name]}' for name in sorted(self._poses))
            print(f'\r{self._time:6.1f} of {self._duration:.1f} s  {poses}', end='', flush=True)

    def are_subscribed(self, nodes: int) -> bool:
        """Return whether a number of nodes receive the odometry of all robots."""
        return all(self._node.count_subscribers(f'{name}/odom') >= nodes for name in self._robots)

    def is_moving(self) -> bool:
        return monotonic() - self._last < IDLE_TIME

    def close(self) -> None:
        if sys.stdout.isatty():
            print()
        self._node.destroy_node()

    def _subscribe(self, name: str) -> None:
        def receive(raw: bytes) -> None:
            message = deserialize(raw, POSE_WITH_COVARIANCE)
            self._last = monotonic()
            self._time = from_time(message.header.stamp) / NS - 1.0
            p, P = message.pose.pose.position, from_covariance(message.pose.covariance)
            sigma = (P[0, 0] + P[1, 1]) ** 0.5
            self._poses[name] = f'({p.x:7.2f}, {p.y:7.2f}) +- {sigma:.2f} m'

        self._node.create_subscription(
            message_class(POSE_WITH_COVARIANCE), f'{name}/pose', receive, reliable(100), raw=True)
