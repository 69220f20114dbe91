# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that check what rclpy passes on unchecked: simulated time, parameters and requests."""

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any, cast

from rcl_interfaces.msg import (
    FloatingPointRange, IntegerRange, Parameter as ParameterMessage, ParameterDescriptor,
    SetParametersResult)
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import Clock, ROSClock
from rclpy.clock_type import ClockType
from rclpy.event_handler import EventHandler
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock as ClockMessage

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.core.records import NS
from fej_slam_ros.errors import UsageError
from fej_slam_ros.ros.nodes.endpoints import taken_message
from fej_slam_ros.ros.nodes.ros_process import first_line
from fej_slam_ros.ros.parameters import PARAMETERS_OF_ROS, rejection, Value
from fej_slam_ros.ros.parameters.values import MAX_WARNINGS, shortened

#: Maximum number of parameters in one request; 20 robots have 400.
MAX_REQUEST = 500
#: Codes of the types of parameters.
KNOWN_TYPES = {kind.value for kind in RosParameter.Type}


class CheckedClockNode(Node):
    """A node that ignores simulated time out of range, with which another node would end it."""

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[..., None], *args: Any, **kwargs: Any
    ) -> Subscription:
        """Create a subscription; that of the clock is created by rclpy."""
        def receive(message: ClockMessage) -> None:
            if message.clock.sec >= 0 and message.clock.nanosec < NS:
                callback(message)

        of_clock = msg_type is ClockMessage
        return super().create_subscription(
            msg_type, topic, receive if of_clock else callback, *args, **kwargs)

    def take_clock(self) -> None:
        """
        Set simulated time to its newest message, without the executor.

        Input that is received without the executor would be ahead of the time before a stall.

        """
        if cast(ROSClock, self.get_clock()).ros_time_is_active:
            clock = next(s for s in self.subscriptions if s.msg_type is ClockMessage)
            if (taken := taken_message(clock)) is not None:
                clock.callback(taken[0])

    def create_steady_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """Create a timer of a period [s] that does not wait for simulated time."""
        return self.create_timer(period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


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
            raise UsageError(f'ROS cannot create the node: {first_line(error)}') from error
        overrides: dict[str, Any] = self.get_parameters_by_prefix('')
        self.given = {name: parameter.value for name, parameter in overrides.items()}
        for service in self.services:
            if service.srv_type in {SetParameters, SetParametersAtomically}:
                service.callback = partial(self._answer, service.callback)

    def known_parameters(self) -> Mapping[str, Parameter]:
        """Return the parameters of the node by name."""
        raise NotImplementedError

    def changeable_parameters(self) -> Collection[str]:
        """Return the names of those that can change while the node runs."""
        return ()

    def set_parameters_atomically(self, parameter_list: list[RosParameter]) -> SetParametersResult:
        """Set parameters; unlike in rclpy, the reason of a rejection says what to do."""
        known = self.known_parameters()
        changeable = {*self.changeable_parameters(), *PARAMETERS_OF_ROS}
        for change in parameter_list:
            reason = rejection(change.name, known, changeable)
            if reason is not None:
                return SetParametersResult(successful=False, reason=reason)
        return super().set_parameters_atomically(parameter_list)

    def redeclare(
        self, values: Mapping[str, Value], known: Mapping[str, Parameter],
        changeable: Collection[str] = (),
    ) -> None:
        """
        Declare the parameters again by their checked values: an integer has become a float.

        Overrides of the quality of service are declared with their topics.

        """
        for name in self.given.keys() - PARAMETERS_OF_ROS:
            self.undeclare_parameter(name)
        for name, value in values.items():
            described = _descriptor(known[name], read_only=name not in changeable)
            self.declare_parameter(name, value, described, ignore_override=True)

    # The executor still calls what was ready before it was destroyed, which must do nothing then.

    def destroy_service(self, service: Service) -> bool:
        """Destroy a service; requests to it that wait for the executor are dropped."""
        # An answer would end the node.
        vars(service).update(
            callback=lambda _request, response: response,
            send_response=lambda _response, _header: None)
        return bool(super().destroy_service(service))

    def destroy_subscription(self, subscription: Subscription) -> bool:
        """Destroy a subscription; what waits on it for the executor is dropped."""
        subscription.callback = lambda _message: None
        drop_events(subscription)
        return bool(super().destroy_subscription(subscription))

    def destroy_publisher(self, publisher: Publisher) -> bool:
        """Destroy a publisher; its events that wait for the executor are dropped."""
        drop_events(publisher)
        return bool(super().destroy_publisher(publisher))

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


def drop_events(endpoint: Subscription | Publisher) -> None:
    """Drop the events of an endpoint that wait for the executor, which cannot take them later."""
    # rclpy declares the list of handlers as a single one.
    for handler in cast(list[EventHandler], endpoint.event_handlers):
        vars(handler).update(take_data=lambda: None)


def _descriptor(parameter: Parameter, read_only: bool) -> ParameterDescriptor:
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
