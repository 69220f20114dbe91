# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes in processes that end with their test, and a node that publishes and subscribes."""

from contextlib import contextmanager, ExitStack, suppress
from functools import cached_property
import gc
import os
from pathlib import Path
import socket
from tempfile import TemporaryDirectory
import time
from unittest import mock

import rclpy
from rclpy.experimental.events_executor import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from fej_slam_ros.ros import parameters
from fej_slam_ros.ros.messages import deserialize
from fej_slam_ros.ros.nodes.endpoints import message_class
from fej_slam_ros.ros.nodes.estimator import EstimatorNode
from fej_slam_ros.ros.nodes.event_loop import serve
from fej_slam_ros.ros.nodes.qos import reliable
from fej_slam_ros.ros.nodes.ros_process import Stop
from helpers.processes import DEADLINE, end_session, start_verb, until
from helpers.ros import write_parameters

DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'

#: Time without a response after which a service is called again [s].
REPEAT_CALL = 20.0
#: How long to wait for a message before looking again at what a test waits for [s].
PAUSE = 0.05


@contextmanager
def free_domain():
    """Yield the number of a ROS domain that no other test on this machine uses at the time."""
    with socket.socket(socket.AF_UNIX) as claim:
        for number in range(1, 101):
            with suppress(OSError):
                claim.bind(f'\0fej_slam_ros tests in ROS domain {number}')
                break
        yield number


def on_the_wire(raw):
    """Return the bytes of a message as they arrive: DDS fills them up to a multiple of four."""
    return raw + bytes(-len(raw) % 4)


def reliable_inputs(robots):
    """Return the parameters with which nothing is lost on the way to an estimator."""
    return {
        f'qos_overrides./{robot}/{kind}.subscription.{policy}': value
        for robot in robots for kind in ('odom', 'landmarks', 'robots', 'ground_truth')
        for policy, value in (('reliability', 'reliable'), ('depth', 3000))}


def live_values(parameter_file, output):
    """Return the parameters of a live run that loses nothing, however busy the machine is."""
    values = parameters.load_values(parameter_file, ['estimator'])
    return {
        **values, **reliable_inputs(values['robots']), 'stale_after': 30.0, 'output': str(output)}


class Domain:
    """
    A ROS domain of a test's own, on this machine only.

    Its node works, and an estimator in this process with it, only while a test waits.
    """

    def __init__(self):
        self._stack = ExitStack()
        self._estimator = None
        self._publishers = {}

    def __enter__(self):
        # What exists already need not be searched when the domain ends.
        gc.freeze()
        number = self._stack.enter_context(free_domain())
        logs = self._stack.enter_context(TemporaryDirectory())
        environment = {
            'ROS_DOMAIN_ID': str(number), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_LOG_DIR': logs}
        self._stack.enter_context(mock.patch.dict(os.environ, environment))
        return self

    def __exit__(self, *_):
        self._stack.close()
        # Nodes stay in their domain until they are collected, and the next test with the same
        # number would discover them there.
        vars(self).clear()
        gc.collect()
        gc.unfreeze()

    def start(self, verb, *words):
        """Start a verb as a process that ends with the domain."""
        return self.ending(start_verb(verb, *words))

    def ending(self, process):
        """Return a process, which ends with the domain."""
        self._stack.callback(end_session, process)
        return process

    def finish(self, process, number=None, deadline=DEADLINE):
        """Wait until a process ends, which may get a signal; return its status and its errors."""
        if number is not None:
            process.send_signal(number)
        until(lambda: process.poll() is not None, self._work, deadline)
        return process.returncode, process.communicate()[1]

    def estimate(self, *ros_args, **values):
        """Return an estimator in this process."""
        with TemporaryDirectory() as folder:
            path = write_parameters(Path(folder) / 'parameters.yaml', **values)
            self._init(['--ros-args', '--params-file', str(path), *ros_args])
            self._estimator = self._added(EstimatorNode(Stop()))
        return self._estimator

    def has_publisher(self, topic):
        """Return whether all subscriptions of the estimator to a topic know a publisher."""
        subscriptions = [
            subscription for subscription in self._estimator.subscriptions
            if subscription.topic_name == topic]
        return all(subscription.get_publisher_count() > 0 for subscription in subscriptions)

    def end_estimate(self):
        """End the estimator in this process as a signal would."""
        serve(self._estimator, self._executor)
        self._estimator.close()

    @cached_property
    def node(self):
        """Return the node of the test."""
        if not rclpy.ok():
            self._init([])
        return self._added(Node('listener', use_global_arguments=False))

    def until(self, condition):
        """Wait until a condition holds."""
        until(condition, self._work)

    def record(self, topic, type_name):
        """Return a list that fills with the bytes of the messages on a topic."""
        messages = []
        self.node.create_subscription(
            message_class(type_name), topic, messages.append, reliable(10_000), raw=True)
        return messages

    def listen(self, topic, type_name):
        """Return a list that fills with the messages on a topic."""
        messages = []
        self.node.create_subscription(
            message_class(type_name), topic,
            lambda raw: messages.append(deserialize(raw, type_name)), reliable(1000), raw=True)
        return messages

    def wait_for_reports(self):
        """
        Return a list that fills with diagnostics, once the first ones have arrived.

        DDS discovers endpoints in order: what was listened to before is connected then, too.

        """
        messages = self.listen('/diagnostics', DIAGNOSTICS)
        self.until(lambda: messages)
        return messages

    def send(self, *messages):
        """Publish raw messages, each topic when it has a subscriber."""
        for message in messages:
            if message.topic not in self._publishers:
                publisher = self._publishers[message.topic] = self.node.create_publisher(
                    message_class(message.type_name), message.topic, reliable(1000))
                self.until(publisher.get_subscription_count)
            self._publishers[message.topic].publish(message.raw)

    def call(self, service):
        """Call a trigger and return whether it succeeded."""
        return self.ask(service, Trigger).success

    def ask(self, service, service_type, **fields):
        """
        Call a service and return its response.

        It is called again if its response was lost, since the client was not discovered yet.

        """
        client = self.node.create_client(service_type, service)
        self.until(client.service_is_ready)
        futures = []

        def is_answered():
            if time.monotonic() > first + REPEAT_CALL * len(futures):
                futures.append(client.call_async(service_type.Request(**fields)))
            return any(future.done() for future in futures)

        first = time.monotonic()
        self.until(is_answered)
        return next(future.result() for future in futures if future.done())

    def _init(self, ros_args):
        rclpy.init(args=ros_args, signal_handler_options=SignalHandlerOptions.NO)
        self._stack.callback(rclpy.try_shutdown)
        self._executor = EventsExecutor()

    def _added(self, node):
        self._executor.add_node(node)
        # A node that waits for garbage collection still receives messages.
        self._stack.callback(node.destroy_node)
        return node

    def _work(self):
        if self._estimator is None:
            self.node.executor.spin_once(PAUSE)
        else:
            serve(self._estimator, self._executor)
