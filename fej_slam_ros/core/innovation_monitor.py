# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of the innovations of all updates: consistency, likelihood and lost robots."""

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.data_association.failure_detection import LostRobotDetector
from fej_slam_ros.core.ekf.filter import Innovation


class InnovationMonitor:
    """
    Statistics of the innovations.

    Attributes
    ----------
    nis : normalised innovations squared of each robot
    log_likelihood : of all innovations, up to a constant
    lost_robots : detector of robots that are likely lost

    """

    def __init__(self) -> None:
        self.nis: dict[str, NisMonitor] = {}
        self.log_likelihood = 0.0
        self.lost_robots = LostRobotDetector()

    def add(self, stamp: int, innovation: Innovation) -> None:
        """Add the innovation of one update at a stamp [ns]."""
        for robot, values in innovation.nis().items():
            self.nis[robot].add(stamp, values)
        self.log_likelihood += innovation.log_likelihood()
        self.lost_robots.add(innovation.scan_gate_statistics())
