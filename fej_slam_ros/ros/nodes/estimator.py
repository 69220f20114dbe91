# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The estimator as a node: topics in, fused poses and the map out."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from time import monotonic, perf_counter

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.publisher import Publisher
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_srvs.srv import Trigger

from fej_slam_ros.core.settings import Settings
from fej_slam_ros.errors import UserError
from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.diagnostics import Diagnostics
from fej_slam_ros.ros.inputs import TRUE_LANDMARKS
from fej_slam_ros.ros.messages import RawMessage, serialize
from fej_slam_ros.ros.nodes.process import (
    best_effort, message_class, ParameterNode, reliable, ros, RoundExecutor, wait_for_arrival)
from fej_slam_ros.ros.outputs import Publication
from fej_slam_ros.ros.run import Run

NODE = 'estimator'
INPUT_DEPTH = 200
OUTPUT_DEPTH = 100
REPORT_PERIOD = 1.0
SPIN_TIMEOUT = 0.1
#: So many messages of each topic are taken in between steps at most.
MAX_ROUNDS = 1000


class EstimatorNode(ParameterNode):
    """
    Declares, converts, calls, converts, publishes.

    Attributes
    ----------
    received : how many messages have come

    """

    def __init__(self) -> None:
        super().__init__(NODE)
        self.received = 0
        self._settings = self._read_settings()
        self._last_input: int | None = None
        self._saved_at = monotonic()
        self._begin(self._settings)
        self._publishers_by_topic = {
            topic: self._create_output(topic, type_name)
            for topic, type_name in self._run.outputs.topics.items()}
        for topic, type_name in self._run.inputs.topics.items():
            self._subscribe(topic, type_name)
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(Trigger, '~/save', self._save)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(REPORT_PERIOD, self._report, clock=steady)

    def close(self) -> None:
        """Finish and publish the last steps and complete the files: the input has ended."""
        if self._settings.autosave_period:
            self._autosave()
        self._publish(self._run.close())
        self._last_input = None
        self._report()
        told = self._run.keep()
        self.get_logger().info(f'state hash {told["state_hash"]}')
        if self._settings.output:
            self.get_logger().info(f'files are in {self._settings.output}')
        wait_for_arrival(self._publishers_by_topic.values())

    def discard(self) -> None:
        """Leave no file behind that is not complete."""
        self._run.discard()

    def _read_settings(self) -> Settings:
        settings = parameters.parse(self.given)
        told = parameters.describe([robot.name for robot in settings.robots])
        for name, value in parameters.as_parameters(settings).items():
            descriptor = ParameterDescriptor(description=told[name], read_only=True)
            if name in self.given:
                self.undeclare_parameter(name)
            # What was given is declared anew, as checked: an integer has become a float.
            self.declare_parameter(name, value, descriptor, ignore_override=True)
        return settings

    def _begin(self, settings: Settings) -> None:
        self._run = Run(settings, Path(settings.output) if settings.output else None)
        if settings.restore:
            goes_on = 'goes on from' if self._run.is_restored else 'begins anew: there is not yet'
            self.get_logger().info(f'{goes_on} {settings.restore}')
        self._diagnostics = Diagnostics(self._run.estimator, self._run.inputs)
        self._last_input = None

    def _next_output(self) -> str:
        """Return a folder of its own for the files of a run after a reset."""
        output = self._settings.output
        folders = (f'{output}_{number}' for number in count(2))
        return output and next(folder for folder in folders if not Path(folder).exists())

    def _create_output(self, topic: str, type_name: str) -> Publisher:
        latched = topic.endswith('landmarks')
        qos = reliable(1, latched=True) if latched else reliable(OUTPUT_DEPTH)
        return self.create_publisher(message_class(type_name), topic, qos)

    def _subscribe(self, topic: str, type_name: str) -> None:
        def receive(raw: bytes) -> None:
            self._receive(RawMessage(topic, type_name, self._now(), raw))

        qos = reliable(1, latched=True) if topic == TRUE_LANDMARKS else best_effort(INPUT_DEPTH)
        self.create_subscription(
            message_class(type_name), topic, receive, qos, raw=True,
            qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def _receive(self, message: RawMessage) -> None:
        self.received += 1
        self._last_input = message.received
        self._run.receive(message)

    def do_steps(self) -> None:
        """Do and publish the steps that are due."""
        begin = perf_counter()
        if self._publish(self._run.take()):
            self._diagnostics.step_times.append(perf_counter() - begin)

    def release_if_idle(self) -> None:
        """Do and publish the last steps where no input has come for a while."""
        now = self._now()
        if now is None or self._last_input is None:
            return
        if now - self._last_input > self._settings.stale_after * 1e9:
            self._last_input = None
            self._publish(self._run.release())

    def autosave_if_due(self) -> None:
        """Save the run where it has not been saved for a while."""
        period = self._settings.autosave_period
        if period and monotonic() - self._saved_at >= period:
            self._autosave()

    def _autosave(self) -> None:
        self._saved_at = monotonic()
        try:
            self._run.save()
        except UserError as error:
            self.get_logger().error(str(error))

    def _report(self) -> None:
        now = self._now() or 0
        self._publish(self._run.outputs.overview(self._is_wanted))
        self._publish([self._diagnostics.report(now, at_rest=self._last_input is None)])

    def _is_wanted(self, topic: str) -> bool:
        wanted: bool = self._publishers_by_topic[topic].get_subscription_count() > 0
        return wanted

    def _publish(self, publications: Iterable[Publication]) -> int:
        """Publish, and return how many messages that were."""
        published = 0
        for topic, message in publications:
            self._publishers_by_topic[topic].publish(serialize(message))
            published += 1
        return published

    def _reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._publish(self._run.close())
        self._run.keep()
        self._begin(replace(self._settings, output=self._next_output(), restore=''))
        response.success = True
        response.message = 'forgot everything; step 0 is to come'
        return response

    def _save(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = f'saved to {self._run.save()}'
            response.success = True
        except UserError as error:
            response.message = str(error)
        return response

    def _now(self) -> int | None:
        """Return ROS time [ns], or None while simulated time has not begun."""
        return self.get_clock().now().nanoseconds or None


def main(ros_args: Sequence[str]) -> int:
    """Run the node until SIGINT or SIGTERM."""
    with ros(ros_args) as stopped:
        node = EstimatorNode()
        executor = RoundExecutor()
        executor.add_node(node)
        try:
            while not stopped.is_set():
                serve(node, executor)
            serve(node, executor)
            node.close()
        finally:
            node.discard()
            node.destroy_node()
    return 0


def serve(node: EstimatorNode, executor: RoundExecutor) -> None:
    """
    Take in all messages that are there, then do the steps that are due.

    A round takes one message of each topic, so that after a stall the topics are out of step with
    each other and with time; only after a round without messages is it known what has arrived.

    """
    executor.spin_round(SPIN_TIMEOUT)
    for _ in range(MAX_ROUNDS):
        before = node.received
        executor.spin_round(0.0)
        if node.received == before:
            break
    node.do_steps()
    node.release_if_idle()
    node.autosave_if_due()
