# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Start and end of a process with a node, and small helpers for all nodes."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
import os
from pathlib import Path
import re
import select
from time import monotonic, sleep
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, Parameter as ParameterMessage, ParameterDescriptor,
    SetParametersResult)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
import rclpy
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rclpy.utilities import try_shutdown
from rosgraph_msgs.msg import Clock

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.core.pieces import EndedError
from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UsageError
from fej_slam_ros.interrupts import handled
from fej_slam_ros.ros.parameters.parsing import MAX_WARNINGS, shortened
from fej_slam_ros.ros.parameters.yaml_bounds import MAX_PARAMETER_FILE
from fej_slam_ros.ros.parameters.yaml_files import check_for_ros

#: Longest wait for acknowledgements of the last messages [s]: above the DDS heartbeat of 3 s.
MAX_ACK_WAIT = 4.0
#: Wait [s] for best-effort subscribers, which acknowledge nothing, before publishers end.
UNACKNOWLEDGED_WAIT = 0.25
#: Duration [s] after the request of the end for which waiting steps are processed, so that the
#: process ends within two seconds.
MAX_LAST_STEPS_TIME = 0.5
#: Duration [s] after it for which a state hash and maps to publish may be computed.
MAX_FINAL_TIME = 0.8
#: Period in which these waits check whether the end has become urgent.
URGENCY_CHECK_PERIOD = Duration(seconds=0.05)

#: Rules in the arguments of ROS, in whose errors it names the token that its parser misses.
RULE = re.compile(r"Couldn't parse (remap|parameter override) rule: '(.*)'\. Error: ")
RULE_FORMS = {
    'remap': '-r OLD:=NEW, -r __node:=NAME or -r __ns:=/NAME',
    'parameter override': '-p NAME:=VALUE with a value in YAML'}

#: Maximum number of parameters in one request; 20 robots have 400.
MAX_REQUEST = 500
#: Codes of the types of parameters.
KNOWN_TYPES = {kind.value for kind in RosParameter.Type}


class Stop:
    """
    A request to end the process, which a signal handler may set.

    Unlike with threading.Event, a handler that interrupts `wait` in the same thread cannot block
    for ever on a lock that `wait` holds.

    """

    def __init__(self) -> None:
        self._set_at: float | None = None
        self._is_urgent = False
        self._reader, self._writer = os.pipe()

    def __enter__(self) -> 'Stop':
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._reader)
        os.close(self._writer)

    def is_set(self) -> bool:
        """Return whether the end is requested."""
        return self._set_at is not None

    def set(self) -> None:
        """Request the end."""
        if self._set_at is None:
            self._set_at = monotonic()
            os.write(self._writer, b'.')

    def is_overdue(self) -> bool:
        """Return whether no further step is to be processed before the end."""
        return self._lasts_longer_than(MAX_LAST_STEPS_TIME)

    def check_time(self) -> None:
        """Raise EndedError if nothing more is to be computed before the end."""
        if self._lasts_longer_than(MAX_FINAL_TIME):
            raise EndedError

    def is_urgent(self) -> bool:
        """Return whether the end is requested without waiting for other processes."""
        return self._is_urgent

    def set_urgent(self) -> None:
        """Request the end without waiting for other processes."""
        self._is_urgent = True
        self.set()

    def wait(self, timeout: float) -> None:
        """Wait until the end is requested, at most for a timeout [s]."""
        select.select([self._reader], [], [], timeout)

    def _lasts_longer_than(self, duration: float) -> bool:
        return self._set_at is not None and monotonic() - self._set_at > duration


@contextmanager
def ros(ros_args: Sequence[str]) -> Iterator[Stop]:
    """
    Initialise ROS for the duration of the context; yield the stop request of SIGINT and SIGTERM.

    The handlers of rclpy would shut down at once, before the last steps are published.

    """
    _check_parameter_files(ros_args)
    try:
        rclpy.init(args=list(ros_args), signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        # ROS names the line of a file, but neither the parameter nor a cure.
        for path in _parameter_files(ros_args):
            check_for_ros(path)
        raise UsageError(f'ROS does not accept {_refused_argument(error)}') from None
    with Stop() as stopped, handled(stopped.set, stopped.set_urgent):
        try:
            yield stopped
        finally:
            try_shutdown()


class CheckedClockNode(Node):
    """A node that ignores simulated time out of range, with which another node would end it."""

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *args: Any, **kwargs: Any
    ) -> Subscription:
        """Create a subscription; that of the clock is created by rclpy."""
        def receive(message: Clock) -> None:
            if message.clock.sec >= 0 and message.clock.nanosec < NS:
                callback(message)

        of_clock = msg_type is Clock
        return super().create_subscription(
            msg_type, topic, receive if of_clock else callback, *args, **kwargs)


class ParameterNode(CheckedClockNode):
    """
    A node with all parameters that were passed to it, still unchecked.

    Attributes
    ----------
    given : value of each parameter by full name

    """

    def __init__(self, name: str) -> None:
        try:
            super().__init__(name, automatically_declare_parameters_from_overrides=True)
        except ValueError as error:
            raise UsageError(
                'a parameter is an empty list, which has no type: leave it out, or fill it,'
                ' for example robots: [r1, r2]') from error
        except (RuntimeError, NameValidationException) as error:
            raise UsageError(f'ROS cannot create the node: {_first_line(error)}') from error
        overrides: dict[str, Any] = self.get_parameters_by_prefix('')
        self.given = {name: parameter.value for name, parameter in overrides.items()}
        for service in self.services:
            if service.srv_type in {SetParameters, SetParametersAtomically}:
                service.callback = partial(self._answer, service.callback)

    # What was ready when one of these is destroyed still waits for the executor, which would call
    # it.

    def destroy_service(self, service: Service) -> bool:
        """Destroy a service; requests to it that wait for the executor are dropped."""
        # An answer would end the node.
        vars(service).update(
            callback=lambda _request, response: response,
            send_response=lambda _response, _header: None)
        return bool(super().destroy_service(service))

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription; messages on it that wait for the executor are dropped."""
        subscription.callback = lambda _message: None
        return bool(super().destroy_subscription(subscription))

    def destroy_timer(self, timer: Timer) -> bool:
        """Destroy a timer, also if it is due."""
        timer.callback = lambda: None
        return bool(super().destroy_timer(timer))

    def _answer(self, set_all: Callable[[Any, Any], Any], request: Any, response: Any) -> Any:
        """Set the parameters of a request, or refuse all if rclpy would end or block the node."""
        reason = self._request_fault(request.parameters)
        if not reason:
            return set_all(request, response)
        refused = SetParametersResult(successful=False, reason=reason)
        if isinstance(response, SetParameters.Response):
            response.results = [refused for _ in request.parameters]
        else:
            response.result = refused
        return response

    def _request_fault(self, parameters: Sequence[ParameterMessage]) -> str:
        if len(parameters) > MAX_REQUEST:
            return f'a request sets at most {MAX_REQUEST} parameters: send several'
        for parameter in parameters:
            if parameter.value.type not in KNOWN_TYPES:
                return (
                    f'parameter {shortened(parameter.name)!r} has the type'
                    f' {parameter.value.type}, which ROS does not define')
        unknown = [
            requested.name for requested in parameters if not self.has_parameter(requested.name)]
        if len(unknown) > MAX_WARNINGS:
            return f'{len(unknown)} parameters are unknown, such as {shortened(unknown[0])!r}'
        return ''


def taken_message(subscription: Subscription) -> tuple[bytes, Any] | None:
    """Return the next message of a raw subscription without the executor, and its information."""
    with subscription.handle:
        taken: tuple[bytes, Any] | None = subscription.handle.take_message(
            subscription.msg_type, subscription.raw)
    return taken


def check_topic_names(node: Node, topics: Iterable[str]) -> None:
    """Raise UsageError for a name that is none in ROS, or not in this namespace, or remapped."""
    checked = ''
    try:
        for checked in topics:
            node.resolve_topic_name(checked)
    except (RuntimeError, NameValidationException) as error:
        raise UsageError(
            f'ROS refuses the topic {shortened(checked)!r} ({_first_line(error)}): choose other or'
            ' shorter names of robots and namespaces, or another remapping') from None


def descriptor(parameter: Parameter, read_only: bool) -> ParameterDescriptor:
    """Return a descriptor with the range of a parameter, or with words where no range is exact."""
    kind = parameter.kind
    described = ParameterDescriptor(description=str(parameter), read_only=read_only)
    within = kind.within
    if within is None or within.excludes_low or kind.shape:
        described.additional_constraints = kind.expected
    if within is not None and kind.element is int:
        described.integer_range = [IntegerRange(from_value=within.low, to_value=within.high)]
    elif within is not None:
        described.floating_point_range = [
            FloatingPointRange(from_value=float(within.low), to_value=float(within.high))]
    return described


def is_installed(type_name: str) -> bool:
    """Return whether the package of a message type is installed."""
    return find_spec(type_name.partition('/')[0]) is not None


def debian_package(type_name: str) -> str:
    """Return the name of the Debian package of a message type."""
    return f'ros-jazzy-{type_name.partition("/")[0].replace("_", "-")}'


def message_class(type_name: str) -> Any:
    """Return the class of a message type such as ``nav_msgs/msg/Odometry``."""
    package, kind, name = type_name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


def reliable(depth: int, latched: bool = False) -> QoSProfile:
    """Return a reliable profile; latched publishers keep the last message for late subscribers."""
    durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE
    return QoSProfile(
        depth=depth, reliability=QoSReliabilityPolicy.RELIABLE, durability=durability)


def best_effort(depth: int) -> QoSProfile:
    """Return a best-effort profile."""
    return QoSProfile(depth=depth, reliability=QoSReliabilityPolicy.BEST_EFFORT)


def wait_for_arrival(
    publishers: Iterable[Publisher], is_urgent: Callable[[], bool] = lambda: False
) -> None:
    """
    Wait until the subscribers have received all messages, as far as they acknowledge them.

    The wait ends early when it has become urgent to end.

    """
    give_up = monotonic() + MAX_ACK_WAIT
    for publisher in publishers:
        while not publisher.wait_for_all_acked(URGENCY_CHECK_PERIOD):
            if is_urgent() or monotonic() > give_up:
                return
    give_up = monotonic() + UNACKNOWLEDGED_WAIT
    while monotonic() < give_up and not is_urgent():
        sleep(URGENCY_CHECK_PERIOD.nanoseconds * 1e-9)


def _check_parameter_files(ros_args: Sequence[str]) -> None:
    # The error of rcl is several lines long.
    for path in _parameter_files(ros_args):
        if not path.is_file():
            raise UsageError(f'{path} does not exist: give the path of a ROS parameter file')
        # rcl would read it for minutes.
        if path.stat().st_size > MAX_PARAMETER_FILE:
            raise UsageError(
                f'{path} is larger than {MAX_PARAMETER_FILE:,} bytes: give the path of a ROS'
                ' parameter file')


def _parameter_files(ros_args: Sequence[str]) -> list[Path]:
    return [Path(path) for option, path in pairwise(ros_args) if option == '--params-file']


def _refused_argument(error: Exception) -> str:
    """Return the argument that ROS refuses, and its form or the reason."""
    text = _first_line(error)
    rule = RULE.search(text)
    return f'{rule[2]!r}: write {RULE_FORMS[rule[1]]}' if rule else f'its arguments: {text}'


def _first_line(error: Exception) -> str:
    # Without the places in the sources of ROS.
    return str(error).strip().splitlines()[0].partition(', at /')[0].rstrip(':')
