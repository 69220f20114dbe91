# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the processes of all nodes have in common: a clean beginning and a clean end."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import pairwise
import os
from pathlib import Path
import select
import signal
from time import monotonic, sleep
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.errors import UsageError

#: How long the last messages are given to arrive [s]; DDS asks every 3 s whether they have.
LINGER = 4.0
#: The same where nobody asks: a message goes with its sender if it has not been read by then [s].
GRACE = 0.5


class Stop:
    """
    Whether the process is to end; a signal handler may set it.

    A threading.Event would not do: a handler that interrupts its `wait` may find it locked by the
    very thread that it runs in, for ever.

    """

    def __init__(self) -> None:
        self._is_set = False
        self._reader, self._writer = os.pipe()

    def __enter__(self) -> 'Stop':
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._reader)
        os.close(self._writer)

    def is_set(self) -> bool:
        """Return whether the process is to end."""
        return self._is_set

    def set(self) -> None:
        """Let the process end."""
        if not self._is_set:
            self._is_set = True
            os.write(self._writer, b'.')

    def wait(self, timeout: float) -> None:
        """Wait for so many seconds, or until it is set."""
        select.select([self._reader], [], [], timeout)


@contextmanager
def ros(ros_args: Sequence[str]) -> Iterator[Stop]:
    """
    Run ROS; yield what SIGINT or SIGTERM sets.

    rclpy's own handlers would shut the context down at once, before the last steps are published.
    A second signal ends the process the hard way.

    """
    _check_parameter_files(ros_args)
    try:
        rclpy.init(args=list(ros_args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise UsageError(f'ROS does not accept its arguments: {_first_line(error)}') from None
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with Stop() as stopped:

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


class ParameterNode(Node):
    """
    A node that has the parameters it is given, checked or not.

    Attributes
    ----------
    given : the value of each parameter by full name

    """

    def __init__(self, name: str) -> None:
        try:
            super().__init__(name, automatically_declare_parameters_from_overrides=True)
        except ValueError as error:
            raise UsageError(
                'a parameter is an empty list: leave it out, or put something into it, for'
                ' example robots: [r1, r2]') from error
        except RuntimeError as error:
            raise UsageError(f'ROS cannot create the node: {_first_line(error)}') from error
        overrides: dict[str, Any] = self.get_parameters_by_prefix('')
        self.given = {name: parameter.value for name, parameter in overrides.items()}


def descriptor(parameter: Parameter, read_only: bool) -> ParameterDescriptor:
    """Return how ROS describes a parameter: by a closed range where that says it all, in words."""
    kind = parameter.kind
    described = ParameterDescriptor(description=str(parameter), read_only=read_only)
    within = None if kind.shape else kind.within
    if within is None or within.excludes_low:
        described.additional_constraints = kind.expected
    if within is not None and kind.element is int:
        described.integer_range = [IntegerRange(from_value=within.low, to_value=within.high)]
    elif within is not None:
        described.floating_point_range = [
            FloatingPointRange(from_value=float(within.low), to_value=float(within.high))]
    return described


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


def wait_for_arrival(publishers: Iterable[Publisher]) -> None:
    """Wait until all subscribers have all messages, as far as one can tell."""
    give_up = monotonic() + LINGER
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(0.0, give_up - monotonic())))
    sleep(GRACE)


def _check_parameter_files(ros_args: Sequence[str]) -> None:
    """Refuse files that are not there in words of our own."""
    for option, path in pairwise(ros_args):
        if option == '--params-file' and not Path(path).is_file():
            raise UsageError(f'{path} is not there: give the path of a ROS parameter file')


def _first_line(error: Exception) -> str:
    return str(error).strip().splitlines()[0]
