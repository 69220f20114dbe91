# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Topics and services of a node: their names and types, and messages that are under way."""

from collections.abc import Callable, Iterable
from importlib import import_module
from importlib.util import find_spec
from time import monotonic, sleep
from typing import Any

from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.nodes.ros_process import first_line
from fej_slam_ros.ros.parameters.values import shortened
from fej_slam_ros.ros.topic_types import MEASUREMENT_TOPICS

#: Last parts of the names of topics with data of sensors of one robot.
SENSOR_TOPICS = {*MEASUREMENT_TOPICS, 'scan'}
#: Longest wait for acknowledgements of the last messages [s]: above the DDS heartbeat of 3 s.
MAX_ACK_WAIT = 4.0
#: Wait [s] for best-effort subscribers, which acknowledge nothing, before publishers end.
UNACKNOWLEDGED_WAIT = 0.25
#: Period in which these waits check whether the end has become urgent.
URGENCY_CHECK_PERIOD = Duration(seconds=0.05)


def check_topic_names(node: Node, topics: Iterable[str]) -> None:
    """
    Raise UsageError for a name that is none in ROS, or not in this namespace, or remapped.

    Remapped measurements of two robots may not have one name, either.

    """
    checked, measured = '', dict[str, str]()
    try:
        for checked in topics:
            name = node.resolve_topic_name(checked)
            if checked.rpartition('/')[2] in SENSOR_TOPICS and (
                    other := measured.setdefault(name, checked)) != checked:
                raise UsageError(
                    f'the topics {other!r} and {checked!r} are both remapped to {name}: give each'
                    ' robot its own')
    except (RuntimeError, NameValidationException) as error:
        raise UsageError(
            f'ROS refuses the topic {shortened(checked)!r} ({first_line(error)}): choose other or'
            ' shorter names of robots and namespaces, or another remapping') from None


def is_installed(type_name: str) -> bool:
    """Return whether the package of a message type is installed."""
    return find_spec(type_name.partition('/')[0]) is not None


def check_installed(type_names: Iterable[str]) -> None:
    """Raise UserError if the package of a message type is not installed."""
    for type_name in type_names:
        if not is_installed(type_name):
            raise UserError(
                f'messages of {type_name} need the package {type_name.partition("/")[0]}: apt'
                f' install {debian_package(type_name)}, or source the workspace that has it;'
                ' without it, fej_slam adapt reads recorded bags, and formats: [marker_array]'
                ' another message')


def debian_package(type_name: str) -> str:
    """Return the name of the Debian package of a message type."""
    return f'ros-jazzy-{type_name.partition("/")[0].replace("_", "-")}'


def message_class(type_name: str) -> Any:
    """Return the class of a message type such as ``nav_msgs/msg/Odometry``."""
    package, kind, name = type_name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


def taken_message(subscription: Subscription) -> tuple[Any, Any] | None:
    """Return the next message of a subscription without the executor, and its information."""
    with subscription.handle:
        taken: tuple[Any, Any] | None = subscription.handle.take_message(
            subscription.msg_type, subscription.raw)
    return taken


def end_service(node: Node, service: Service) -> None:
    """Destroy a service of type Trigger; refuse the requests that wait, which it would lose."""
    refusal = Trigger.Response(success=False, message=(
        f'{service.service_name} ended before it handled the request: repeat the request when the'
        ' service is offered again'))
    while (header := _taken_request(service)) is not None:
        service.send_response(refusal, header)
    node.destroy_service(service)


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


def _taken_request(service: Service) -> Any:
    """Return the header of the next request without the executor, None if there is none."""
    with service.handle:
        _, request_header = service.handle.service_take_request(Trigger.Request)
    return request_header
