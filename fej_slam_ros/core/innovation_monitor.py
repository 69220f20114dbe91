# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Statistics of the innovations of all updates: consistency, likelihood and lost robots."""

from dataclasses import dataclass, field

from fej_slam_ros.core.consistency import NisMonitor
from fej_slam_ros.core.data_association.failure_detection import LostRobotDetector
from fej_slam_ros.core.ekf.filter import Innovation
from fej_slam_ros.core.ekf.gating import Association, StatisticsByRobot
from fej_slam_ros.core.ekf.state import Robot


@dataclass(eq=False)
class InnovationMonitor:
    """Statistics of the innovations."""

    nis: dict[str, NisMonitor] = field(default_factory=dict)  #: NIS of each robot
    log_likelihood: float = 0.0  #: log-likelihood of all innovations, up to a constant
    lost_robots: LostRobotDetector = field(default_factory=LostRobotDetector)

    def add(self, stamp: int, innovation: Innovation, statistics: StatisticsByRobot) -> None:
        """Add the innovation of one update at a stamp [ns], and its `scan_gate_statistics`."""
        for robot, values in innovation.nis().items():
            self.nis[robot].add(stamp, values)
        self.log_likelihood += innovation.log_likelihood()
        self.lost_robots.add(statistics)
        self.lost_robots.rejections.add(innovation, statistics)
        for a in innovation.used:
            self._add_observation_of_robot(a, contradicts=False)
        for gated in innovation.rejected:
            if gated.contradicts():
                self._add_observation_of_robot(gated.association, contradicts=True)

    def _add_observation_of_robot(self, a: Association, contradicts: bool) -> None:
        if isinstance(a.observed, Robot):
            self.lost_robots.by_others.add(a.observer.name, a.observed.name, contradicts)
