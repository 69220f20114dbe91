# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Supervision of simulated time by the clock of the machine."""

from time import monotonic

from rclpy.node import Node

#: Time of the machine [s] for which simulated time may stand still.
CLOCK_PATIENCE = 5.0
NO_CLOCK = 'waiting for /clock: use_sim_time is set'


class ClockWatch:
    """Watch of the simulated time of a node, which may stand still."""

    def __init__(self, node: Node) -> None:
        self._node = node
        # The latest simulated time [ns], and when it changed [s].
        self._latest, self._changed_at = 0, monotonic()

    def fault(self, now: int | None) -> str:
        """Return why the time does not advance, '' if it does; None is before the first."""
        if not self._node.get_parameter('use_sim_time').value:
            return ''
        if now is None:
            return NO_CLOCK
        if now != self._latest:
            self._latest, self._changed_at = now, monotonic()
        standing = monotonic() - self._changed_at
        return '' if standing < CLOCK_PATIENCE else (
            f'simulated time has stood still for {standing:.0f} s')
