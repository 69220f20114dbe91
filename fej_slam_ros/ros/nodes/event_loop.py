# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Main loop of the estimator and smoother processes: add messages, then process the due steps."""

from collections.abc import Callable, Sequence
import gc

from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor

from fej_slam_ros.ros.nodes.ros_process import ros, Stop, warn_of_parameter_files
from fej_slam_ros.ros.nodes.session_node import SessionNode

#: Longest wait for a message [s]: bounds the delay of autosave and of shutdown after SIGINT.
SPIN_TIMEOUT = 0.1


def spin(ros_args: Sequence[str], make_node: Callable[[Stop], SessionNode]) -> int:
    """Serve a new node until SIGINT, SIGTERM or its lifecycle shutdown; return its status."""
    with ros(ros_args) as stopped:
        node = make_node(stopped)
        warn_of_parameter_files(ros_args, node)
        # Existing objects are permanent, so the garbage collector need not scan them again.
        gc.collect()
        gc.freeze()
        # Other executors check every topic for a message on each call.
        executor = EventsExecutor()
        executor.add_node(node)
        try:
            while not (stopped.is_set() or node.is_finalized):
                serve(node, executor)
            serve(node, executor)
            node.close()
        finally:
            node.dispose()
            node.destroy_node()
    return node.exit_status


def serve(node: SessionNode, executor: Executor) -> None:
    """
    Add all messages that have arrived, then process the steps that are due.

    The executor handles messages one by one in the order of their arrival, and without end where
    they arrive as fast. So they are taken from one topic after another, as often as this function
    is called: no step is processed before a scan that had arrived, and none waits for ever.

    """
    executor.spin_once(0.0 if node.is_behind else SPIN_TIMEOUT)
    node.take_messages()
    # The executor has an event for each message that was taken without it, before those of timers
    # and services.
    for _ in range(node.taken + 1):
        executor.spin_once(0.0)
    node.taken = 0
    if node.is_active:
        with node.timed_callback():
            node.work()
            node.write_log()
