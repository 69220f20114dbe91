# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnostics of a node: those of its session, and of its topics, files and clock."""

from time import monotonic
from typing import Any

from rclpy.node import Node

from fej_slam_ros.ros.nodes.node_files import NodeFiles
from fej_slam_ros.ros.nodes.topics import NodeTopics
from fej_slam_ros.ros.session.diagnostics import Diagnostics
from fej_slam_ros.ros.session.node_conditions import also_published, NO_CLOCK, NodeConditions

#: Time of the machine [s] for which simulated time may stand still.
CLOCK_PATIENCE = 5.0


class NodeDiagnostics:
    """Publishes diagnostics of sessions, topics, files and clock; logs new faults."""

    def __init__(self, node: Node, topics: NodeTopics, files: NodeFiles) -> None:
        self._node = node
        self._log = node.get_logger()
        self._topics = topics
        self._files = files
        # The latest simulated time [ns], and when it changed by the clock of the machine [s].
        self._latest_time, self._changed_at = 0, monotonic()

    def publish(self, diagnostics: Diagnostics[Any], now: int | None, at_rest: bool) -> None:
        """Publish a report at a time [ns]; it is None while simulated time has not begun."""
        incompatible, others = self._topics.incompatible(), self._topics.other_publishers()
        for endpoint in incompatible:
            if endpoint not in diagnostics.conditions.incompatible:
                self._log.error(str(endpoint))
        for robot in sorted(others.keys() - diagnostics.conditions.other_publishers.keys()):
            self._log.warning(f'{robot}: {also_published(others[robot])}')
        diagnostics.conditions = NodeConditions(
            incompatible, self._topics.publishers(incompatible), others, self._files.check(),
            self._clock_fault(now))
        self._topics.publish([diagnostics.report(now or 0, at_rest)])

    def _clock_fault(self, now: int | None) -> str:
        """Return why simulated time does not advance, '' if it does; None is before the first."""
        if not self._node.get_parameter('use_sim_time').value:
            return ''
        if now is None:
            return NO_CLOCK
        if now != self._latest_time:
            self._latest_time, self._changed_at = now, monotonic()
        standing = monotonic() - self._changed_at
        return '' if standing < CLOCK_PATIENCE else (
            f'simulated time has stood still for {standing:.0f} s')
