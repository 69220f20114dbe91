# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Robots of a live test that send at a rate, stamped with the present time."""

import numpy as np

from fej_slam_ros.ros.nodes.endpoints import message_class
from fej_slam_ros.ros.nodes.qos import best_effort
from helpers.records import MS, odometry, scan
from helpers.ros import raw_record

#: Where landmarks 1 to 4 are seen from a robot that stands still [m].
VIEW = {1: (5.0, 1.0), 2: (5.0, -1.0), 3: (3.0, 4.0), 4: (2.0, -3.0)}
#: Standard deviation of observations [m], as `helpers.records.scan` states it.
SIGMA = 0.1


class Feed:
    """
    Sends a record at a rate while the test waits.

    Parameters
    ----------
    domain : of the test
    rate : of the messages [Hz]
    record : called with the present time [ms], returns the record to send

    """

    def __init__(self, domain, rate, record):
        self._node = domain.node
        self.record = record
        first = self._message()
        self._publisher = self._node.create_publisher(
            message_class(first.type_name), first.topic, best_effort(100))
        domain.until(self._publisher.get_subscription_count)
        self._timer = self._node.create_timer(1.0 / rate, self._send)

    def pause(self):
        """Send nothing more, but keep the publisher."""
        self._timer.cancel()

    def resume(self):
        """Send again."""
        self._timer.reset()

    def end(self):
        """Send nothing more, without a publisher."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)
        self._publisher = None

    def _message(self):
        return raw_record(self.record(self._node.get_clock().now().nanoseconds / MS))

    def _send(self):
        # A timer that was due when it was destroyed is still called.
        if self._publisher is not None:
            self._publisher.publish(self._message().raw)


def standing(robot):
    """Return odometry of a robot that stands still, by time."""
    return lambda ms: odometry(robot, ms, (0.0, 0.0, 0.0))


def looking(robot, view=None):
    """Return scans of a robot that stands still, by time."""
    rng = np.random.default_rng(1)
    seen = VIEW if view is None else view
    return lambda ms: scan(
        robot, ms, [(number, rng.normal(at, SIGMA)) for number, at in seen.items()])
