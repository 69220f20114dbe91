# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Main loop of the estimator and smoother processes: add messages, then process the due steps."""

from collections.abc import Callable, Sequence
import gc
from time import monotonic

from rclpy.executors import Executor
from rclpy.experimental.events_executor import EventsExecutor

from fej_slam_ros.ros.nodes.ros_process import ros
from fej_slam_ros.ros.nodes.session_node import SessionNode

#: Longest wait for a message [s]: bounds the delay of autosave and of shutdown after SIGINT.
SPIN_TIMEOUT = 0.1
#: Longest time [s] between two calls of `work`, so that input faster than it can be handled cannot
#: block the steps for ever. It is above the time that the messages of a long stall take, since
#: steps before these are handled would treat the rest as late.
MAX_SPIN_TIME = 10.0
#: Period [s] in which the odometry of all robots is taken at once meanwhile: the executor handles
#: messages in the order of their arrival, also thousands of one robot before the next of another.
ODOMETRY_PERIOD = 0.05
#: Number of rounds without a callback after which no message is left; a single one may be for a
#: topic whose messages were handled in an earlier round.
EMPTY_ROUNDS = 3


def spin(ros_args: Sequence[str], make_node: Callable[[], SessionNode]) -> int:
    """Serve a new node until SIGINT, SIGTERM or its lifecycle shutdown; return its status."""
    with ros(ros_args) as stopped:
        node = make_node()
        node.is_overdue, node.is_urgent = stopped.is_overdue, stopped.is_urgent
        node.check_time = stopped.check_time
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

    One round of the executor handles all messages of a single topic. After a stall, some topics
    are therefore ahead of others until no message is left, and processing earlier would treat the
    rest as late.

    """
    executor.spin_once(0.0 if node.is_behind else SPIN_TIMEOUT)
    empty = 0
    begin = taken_at = now = monotonic()
    # The executor has events of the messages that were taken without it.
    while empty < EMPTY_ROUNDS + node.taken and now - begin < MAX_SPIN_TIME:
        before = node.callbacks
        executor.spin_once(0.0)
        empty = empty + 1 if node.callbacks == before else 0
        now = monotonic()
        if now - taken_at > ODOMETRY_PERIOD:
            node.take_odometry()
            taken_at = now
    node.taken = 0
    if node.is_active:
        with node.timed_callback():
            node.work()
            node.write_log()
