# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that compute observations of landmarks from data of sensors, and their loop."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from time import monotonic

from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor

from fej_slam_ros.core.parameter_kinds import Parameter
from fej_slam_ros.ros.messages import prepare, RawMessage, serialize
from fej_slam_ros.ros.nodes import log_writer
from fej_slam_ros.ros.nodes.endpoints import (
    check_topic_names, is_installed, message_class, wait_for_arrival)
from fej_slam_ros.ros.nodes.event_loop import SPIN_TIMEOUT
from fej_slam_ros.ros.nodes.parameter_node import ParameterNode
from fej_slam_ros.ros.nodes.qos import front_end_qos, input_qos, overridable
from fej_slam_ros.ros.nodes.qos_watch import QosWatch
from fej_slam_ros.ros.nodes.ros_process import MAX_LAST_STEPS_TIME, ros, warn_of_parameter_files
from fej_slam_ros.ros.parameters.adapter_settings import AdapterSettings
from fej_slam_ros.ros.parameters.detector_settings import DetectorSettings
from fej_slam_ros.ros.parameters.schema import flat_values
from fej_slam_ros.ros.session.diagnostics import DIAGNOSTICS_PERIOD
from fej_slam_ros.ros.session.front_end import FrontEnd, report
from fej_slam_ros.ros.session.log_lines import LogLine, LogSeverity
from fej_slam_ros.ros.session.node_conditions import IncompatibleQos, NO_CLOCK
from fej_slam_ros.ros.session.outputs import Publication
from fej_slam_ros.ros.topic_types import TF_TYPE

#: Number of reports in a row that have the same warning before it is logged.
PATIENCE = 5
#: Longest time [s] for which messages are added before they are processed, and for which they are
#: processed before others are added.
MAX_SPIN_TIME, MAX_WORK_TIME = 0.1, 0.05
#: Number of rounds of the executor without a message after which none is left.
EMPTY_ROUNDS = 3


def spin(ros_args: Sequence[str], make_node: Callable[[], 'FrontEndNode']) -> int:
    """Run a new node until a signal arrives; return 0."""
    with ros(ros_args) as stopped:
        node = make_node()
        warn_of_parameter_files(ros_args, node)
        executor = EventsExecutor()
        executor.add_node(node)
        while not stopped.is_set():
            _serve(node, executor)
        node.close()
        node.destroy_node()
    return 0


def _serve(node: 'FrontEndNode', executor: Executor) -> None:
    """Add all messages that have arrived, then process them."""
    executor.spin_once(0.0 if node.is_behind else SPIN_TIMEOUT)
    empty, give_up = 0, monotonic() + MAX_SPIN_TIME
    while empty < EMPTY_ROUNDS and monotonic() < give_up:
        before = node.received
        executor.spin_once(0.0)
        empty = empty + 1 if node.received == before else 0
    node.work()


class FrontEndNode(ParameterNode):
    """
    A node that publishes the results of its front end; its parameters are read-only.

    A subclass calls `start` once it has checked its parameters.

    Attributes
    ----------
    received : number of messages received

    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        # Number of reports in a row up to the latest with a line of the log, which is a warning.
        self._reports: dict[str, int] = {}
        self._qos = QosWatch(self)
        self.received = 0
        # Publications that are not computed yet, None if all are published.
        self._due: Iterator[Publication] | None = None

    @property
    def is_behind(self) -> bool:
        """Return whether more is due to be published."""
        return self._due is not None

    def start(
        self, front_end: FrontEnd, settings: AdapterSettings | DetectorSettings,
        known: Mapping[str, Parameter],
    ) -> None:
        """Declare the parameters by their values, and create publishers and subscriptions."""
        self._front_end, self._known = front_end, known
        self.redeclare(flat_values(settings, settings.of_robots), known)
        check_topic_names(self, [*front_end.topics, *front_end.outputs])
        self._outputs = {
            topic: self.create_publisher(message_class(type_name), topic, front_end_qos(topic))
            for topic, type_name in front_end.outputs.items()}
        # Transforms for the whole team are outside of the namespace.
        inputs = {
            topic if '/' in topic else f'/{topic}': (topic, type_name)
            for topic, type_name in front_end.topics.items()
            if type_name != TF_TYPE or is_installed(TF_TYPE)}
        for name, (topic, type_name) in inputs.items():
            self._subscribe(name, topic, type_name)
        names = log_writer.grouped(map(self.resolve_topic_name, inputs))
        self.get_logger().info(f'active: robots {", ".join(front_end.robots)}; inputs {names}')
        if not is_installed(TF_TYPE):
            self.get_logger().info(
                'the places of sensors are not read from /tf_static because tf2_msgs is missing:'
                ' apt install ros-jazzy-tf2-msgs')
        self.create_steady_timer(DIAGNOSTICS_PERIOD, self._report)

    def known_parameters(self) -> Mapping[str, Parameter]:
        return self._known

    def work(self) -> None:
        """Publish what needs no further messages, for a limited time."""
        self._due = self._due or self._front_end.take(
            lambda topic: bool(self._outputs[topic].get_subscription_count()))
        if self._publish_until(monotonic() + MAX_WORK_TIME, self._due):
            self._due = None

    def close(self) -> None:
        """Publish what is left, for a limited time, and wait until it has arrived."""
        left = chain(self._due or (), self._front_end.close())
        self._publish_until(monotonic() + MAX_LAST_STEPS_TIME, left)
        wait_for_arrival(self._outputs.values())

    def _subscribe(self, name: str, topic: str, type_name: str) -> None:
        prepare(type_name)
        self.create_subscription(
            message_class(type_name), name, partial(self._receive, topic, type_name),
            input_qos(topic), raw=True, event_callbacks=self._qos.subscription_events(name),
            qos_overriding_options=overridable())

    def _receive(self, topic: str, type_name: str, raw: bytes) -> None:
        # It is 0 while simulated time has not begun.
        received = self.get_clock().now().nanoseconds or None
        self._front_end.receive(RawMessage(topic, type_name, received, raw))
        self.received += 1

    def _publish_until(self, end: float, publications: Iterable[Publication]) -> bool:
        """Publish until a time of `monotonic`; return whether that was all."""
        for topic, message in publications:
            self._outputs[topic].publish(serialize(message))
            if monotonic() > end:
                return False
        return True

    def _report(self) -> None:
        now = self.get_clock().now().nanoseconds
        incompatible = self._qos.incompatible()
        counts = [
            (robot, self._problems(robot, incompatible) or warnings, values)
            for robot, warnings, values in self._front_end.counts()]
        if not now:
            counts = [(robot, [NO_CLOCK], values) for robot, _, values in counts]
        topic, message = report(self.get_fully_qualified_name().lstrip('/'), counts, now)
        self._outputs[topic].publish(serialize(message))
        lines = [f'{robot}: {warning}' for robot, warnings, _ in counts for warning in warnings]
        self._reports = {line: self._reports.get(line, 0) + 1 for line in lines}
        # Others may take long to start.
        severity = LogSeverity.WARN if now else LogSeverity.INFO
        log_writer.write(self.get_logger(), [
            LogLine(severity, line)
            for line, reports in self._reports.items() if reports == PATIENCE])

    def _problems(self, robot: str, incompatible: Iterable[IncompatibleQos]) -> list[str]:
        """Return what keeps messages on a robot's topics from arriving."""
        topics = {
            self.resolve_topic_name(topic): type_name
            for topic, type_name in self._front_end.topics.items()
            if topic.startswith(f'{robot}/')}
        problems = chain(
            (str(qos) for qos in incompatible if qos.topic in topics),
            (self._other_type(topic, type_name) for topic, type_name in topics.items()))
        return [*filter(None, problems)]

    def _other_type(self, topic: str, type_name: str) -> str:
        published = {found.topic_type for found in self.get_publishers_info_by_topic(topic)}
        others = ', '.join(sorted(published - {type_name}))
        return f'{topic} is published as {others}, this node needs {type_name}' if others else ''
