# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the processes of all nodes have in common: a clean beginning and a clean end."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
import signal
from threading import Event
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from fej_slam_ros.errors import UsageError


@contextmanager
def ros(ros_args: Sequence[str]) -> Iterator[Event]:
    """
    Run ROS; yield an event that SIGINT or SIGTERM sets.

    rclpy's own handlers would shut the context down at once, before the last steps are published.
    A second signal ends the process the hard way.

    """
    try:
        rclpy.init(args=list(ros_args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise UsageError(f'ROS does not accept its arguments: {_first_line(error)}') from None
    stopped = Event()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def stop(number: int, _frame: object) -> None:
        stopped.set()
        signal.signal(number, signal.SIG_DFL)

    for number in handlers:
        signal.signal(number, stop)
    try:
        yield stopped
    finally:
        try_shutdown()
        for number, handler in handlers.items():
            signal.signal(number, handler)


def given_parameters(node: Node) -> dict[str, object]:
    """Return the values of all parameters that a node was given, by full name."""
    overrides: dict[str, Any] = node.get_parameters_by_prefix('')
    return {name: parameter.value for name, parameter in overrides.items()}


def message_class(type_name: str) -> Any:
    """Return the class of a message type such as ``nav_msgs/msg/Odometry``."""
    package, kind, name = type_name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


def reliable(depth: int, latched: bool = False) -> QoSProfile:
    """Return a reliable quality of service; a latched topic keeps its last for late comers."""
    durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
    return QoSProfile(
        depth=depth, reliability=QoSReliabilityPolicy.RELIABLE, durability=durability)


def best_effort(depth: int) -> QoSProfile:
    """Return a best-effort quality of service."""
    return QoSProfile(depth=depth, reliability=QoSReliabilityPolicy.BEST_EFFORT)


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0]
