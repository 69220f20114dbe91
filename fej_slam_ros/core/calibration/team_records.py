# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Records of a team by robot, and its ground truth."""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from operator import attrgetter

from fej_slam_ros.core.geometry import Array, between, compose, pose_at
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import (
    NS, Odometry, Received, RobotScan, Scan, TrueLandmarks, TruePose)
from fej_slam_ros.core.settings import Settings

#: Time [ns] from a sparse true pose within which odometry leads to others; its error is small
#: against that of an observation.
MAX_TRUTH_GAP = NS // 4
#: Longest gap in the odometry [ns] across which it is interpolated.
MAX_ODOMETRY_GAP = NS


class TeamRecords:
    """Odometry and scans of each robot in the order of their stamps, and ground truth."""

    def __init__(self, records: Iterable[Received], settings: Settings) -> None:
        robots = [robot.name for robot in settings.robots]
        self.truth = RecordedTruth()
        self.odometry: dict[str, list[Odometry]] = {robot: [] for robot in robots}
        self.scans: dict[str, list[Scan]] = {robot: [] for robot in robots}
        self.robot_scans: dict[str, list[RobotScan]] = {robot: [] for robot in robots}
        for record, _ in records:
            if isinstance(record, (TruePose, TrueLandmarks)):
                self.truth.add(record)
            elif isinstance(record, Odometry):
                self.odometry[record.robot].append(record)
            elif isinstance(record, Scan):
                self.scans[record.robot].append(record)
            elif isinstance(record, RobotScan):
                self.robot_scans[record.robot].append(record)
        for robot in robots:
            for of_kind in (self.odometry, self.scans, self.robot_scans):
                of_kind[robot].sort(key=attrgetter('stamp'))
        #: true poses of each robot
        self.near = {
            robot: NearTruth(self.truth, robot, self.odometry[robot]) for robot in robots}


class NearTruth:
    """True poses of a robot, also near sparse ones: odometry leads there."""

    def __init__(
        self, truth: RecordedTruth, robot: str, odometry: Sequence[Odometry]
    ) -> None:
        self._truth, self._robot, self._odometry = truth, robot, odometry
        self._isolated = truth.isolated(robot)

    def pose(self, stamp: int) -> Array | None:
        """Return the pose at a stamp [ns], a (3,) array, None if it is not known."""
        true = self._truth.find(self._robot, stamp)
        if true is not None:
            return true
        after = bisect_left(self._isolated, stamp)
        nearest = self._isolated[max(after - 1, 0):after + 1]
        near = [s for s in nearest if abs(s - stamp) <= MAX_TRUTH_GAP]
        if not near:
            return None
        known = min(near, key=lambda s: abs(s - stamp))
        begin, end = (pose_at(s, self._odometry, MAX_ODOMETRY_GAP) for s in (known, stamp))
        if begin is None or end is None:
            return None
        return compose(self._truth.pose(self._robot, known), between(begin, end))
