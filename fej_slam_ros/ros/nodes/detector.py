# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node ``detector``: scans of planar lasers and odometry in, landmarks out."""

from collections.abc import Iterable, Sequence
from functools import partial
from importlib.util import find_spec
from time import monotonic

from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor

from fej_slam_ros.ros.messages import prepare, RawMessage, serialize
from fej_slam_ros.ros.nodes.event_loop import EMPTY_ROUNDS, SPIN_TIMEOUT
from fej_slam_ros.ros.nodes.qos import overridable
from fej_slam_ros.ros.nodes.ros_process import (
    check_topic_names, descriptor, message_class, ParameterNode, reliable, ros, wait_for_arrival)
from fej_slam_ros.ros.nodes.topics import input_qos, OUTPUT_DEPTH
from fej_slam_ros.ros.parameters import PARAMETERS_OF_ROS, QOS_OVERRIDES
from fej_slam_ros.ros.parameters.detector_settings import (
    DETECTOR_PARAMETERS, detector_values, parse_detector)
from fej_slam_ros.ros.session.detector_session import DetectorSession
from fej_slam_ros.ros.session.inputs import TF_TYPE
from fej_slam_ros.ros.session.outputs import Publication

#: Period of the diagnostics [s].
REPORT_PERIOD = 1.0
#: Number of reports that have the same warning before it is logged.
PATIENCE = 5
#: Longest time [s] for which messages are added before scans are processed.
MAX_SPIN_TIME = 1.0


def main(ros_args: Sequence[str]) -> int:
    """Run the node until a signal arrives; return 0."""
    with ros(ros_args) as stopped:
        node = DetectorNode()
        executor = EventsExecutor()
        executor.add_node(node)
        while not stopped.is_set():
            _serve(node, executor)
        node.close()
        node.destroy_node()
    return 0


def _serve(node: 'DetectorNode', executor: Executor) -> None:
    """Add all messages that have arrived, then process the scans that wait for no more."""
    executor.spin_once(SPIN_TIMEOUT)
    empty, give_up = 0, monotonic() + MAX_SPIN_TIME
    while empty < EMPTY_ROUNDS and monotonic() < give_up:
        before = node.received
        executor.spin_once(0.0)
        empty = empty + 1 if node.received == before else 0
    node.work()


class DetectorNode(ParameterNode):
    """
    A node that publishes the landmarks in the scans of some robots; its parameters are read-only.

    Attributes
    ----------
    received : number of messages received

    """

    def __init__(self) -> None:
        super().__init__('detector')
        settings = parse_detector(self.given, self.get_logger().warning)
        for name in self.given.keys() - PARAMETERS_OF_ROS:
            if not name.startswith(QOS_OVERRIDES):
                self.undeclare_parameter(name)
        for name, value in detector_values(settings).items():
            described = descriptor(DETECTOR_PARAMETERS[name], read_only=True)
            self.declare_parameter(name, value, described, ignore_override=True)
        self._session = DetectorSession(settings)
        # The latest warning of each robot, and the number of reports that had it.
        self._warnings: dict[str, tuple[str, int]] = {}
        self.received = 0
        check_topic_names(self, [*self._session.topics, *self._session.outputs])
        self._outputs = {
            topic: self.create_publisher(message_class(type_name), topic, reliable(OUTPUT_DEPTH))
            for topic, type_name in self._session.outputs.items()}
        has_tf = find_spec('tf2_msgs') is not None
        for topic, type_name in self._session.topics.items():
            if has_tf or type_name != TF_TYPE:
                self._subscribe(topic, type_name)
        if not has_tf:
            self.get_logger().info(
                'the places of lasers are not read from /tf_static because tf2_msgs is missing:'
                ' install ros-jazzy-tf2-msgs')
        self.create_timer(REPORT_PERIOD, self._report)

    def work(self) -> None:
        """Publish the landmarks of the scans that wait for no more odometry."""
        self._publish(self._session.take(
            lambda topic: bool(self._outputs[topic].get_subscription_count())))

    def close(self) -> None:
        """Publish the landmarks of the last scans, and wait until they have arrived."""
        self._publish(self._session.close())
        wait_for_arrival(self._outputs.values())

    def _subscribe(self, topic: str, type_name: str) -> None:
        # Transforms for the whole team are outside of the namespace of the node.
        name = f'/{topic}' if '/' not in topic else topic
        prepare(type_name)
        self.create_subscription(
            message_class(type_name), name, partial(self._receive, topic, type_name),
            input_qos(topic), raw=True, qos_overriding_options=overridable())

    def _receive(self, topic: str, type_name: str, raw: bytes) -> None:
        received = self.get_clock().now().nanoseconds
        self._session.receive(RawMessage(topic, type_name, received, raw))
        self.received += 1

    def _publish(self, publications: Iterable[Publication]) -> None:
        for topic, message in publications:
            self._outputs[topic].publish(serialize(message))

    def _report(self) -> None:
        self._publish([self._session.report(self.get_clock().now().nanoseconds)])
        for robot, warning, _ in self._session.counts():
            before, reports = self._warnings.get(robot, ('', 0))
            reports = reports + 1 if warning == before else 1
            self._warnings[robot] = warning, reports
            if warning and reports == PATIENCE:
                self.get_logger().warning(f'{robot}: {warning}')


