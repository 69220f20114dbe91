# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Data of sensors of which landmarks are still to be made, beside the records of the estimator."""

from dataclasses import dataclass

from fej_slam_ros.core.records import GpsFix, Record
from fej_slam_ros.detection.laser_scan import LaserScan
from fej_slam_ros.detection.objects import DetectedObject


@dataclass(frozen=True, slots=True, eq=False)
class RobotLaserScan:
    """A scan of a robot."""

    robot: str  #: name of the robot
    stamp: int  #: time of the first beam [ns]
    scan: LaserScan

    @property
    def end(self) -> int:
        """Return the time of the last beam [ns]."""
        return self.stamp + self.scan.duration


@dataclass(frozen=True, slots=True, eq=False)
class RobotTags:
    """Tags in an image of the camera of a robot, in its optical frame."""

    robot: str  #: name of the robot
    stamp: int  #: time of the image [ns]
    tags: tuple[DetectedObject, ...]


#: What a simulation yields, or a converter.
AnyRecord = Record | GpsFix | RobotLaserScan | RobotTags


def measured_at(record: AnyRecord) -> int:
    """Return the time [ns] at which a record was complete: a scan at its last beam."""
    return record.end if isinstance(record, RobotLaserScan) else record.stamp
