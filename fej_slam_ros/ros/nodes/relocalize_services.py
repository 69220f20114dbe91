# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The services ``<robot>/relocalize``.

A request is published on ``<robot>/set_pose`` as a pose with the covariance of an unknown pose.
The node receives it there like that of any other node, so a recorded bag contains it and `replay`
does the same.
"""

from collections.abc import Callable, Iterable
from functools import partial

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from std_srvs.srv import Trigger

from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.records import PosePrior
from fej_slam_ros.errors import UsageError, UserError
from fej_slam_ros.ros.messages import outgoing, serialize
from fej_slam_ros.ros.nodes.endpoints import end_service, message_class
from fej_slam_ros.ros.nodes.qos import reliable
from fej_slam_ros.ros.topic_types import ROBOT_TOPICS

#: Queue length of the requests, messages.
REQUEST_DEPTH = 10


class RelocalizeServices:
    """
    One service per robot, which makes the robot restart in a frame of its own.

    Parameters
    ----------
    request : returns the record for a robot, or raises a UserError with the reason

    """

    def __init__(self, node: Node, request: Callable[[str], PosePrior]) -> None:
        self._node = node
        self._request = request
        self._endpoints: dict[str, tuple[Service, Publisher]] = {}

    def match(self, robots: Iterable[str]) -> None:
        """Offer the services of some robots, and of no others."""
        robots = [*robots]
        for robot in self._endpoints.keys() - robots:
            service, publisher = self._endpoints.pop(robot)
            end_service(self._node, service)
            self._node.destroy_publisher(publisher)
        for robot in robots:
            if robot not in self._endpoints:
                self._endpoints[robot] = (
                    self._node.create_service(
                        Trigger, f'{robot}/relocalize', partial(self._respond, robot)),
                    self._node.create_publisher(
                        message_class(ROBOT_TOPICS['set_pose']), f'{robot}/set_pose',
                        reliable(REQUEST_DEPTH)))

    def _respond(
        self, robot: str, _request: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        _, publisher = self._endpoints[robot]
        try:
            topic, message = outgoing.input_message(self._request(robot))
            if publisher.get_subscription_count() == 0:
                raise UsageError(f'{topic} has no subscription yet: activate the node')
            # The pose is not used, and map may have another name in messages.
            message.header.frame_id = ''
            publisher.publish(serialize(message))
            response.success = True
            response.message = (
                f'{robot} restarts in {own_frame(robot)} at its next step, and returns to map by'
                ' what it observes')
            self._node.get_logger().info(response.message)
        except UserError as error:
            response.message = str(error)
            self._node.get_logger().warning(f'{robot}/relocalize: {error}')
        return response
