# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a step: poses of robots and relative poses, with covariances."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Scan


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """A robot's pose (3,) after a step, with its covariance P (3, 3), in a frame."""

    robot: str
    stamp: int
    frame: str
    pose: Array
    P: Array


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """
    The pose of a robot in the base frame of another.

    Attributes
    ----------
    seer, seen : names of the robots
    stamp : the later of the stamps [ns] of their poses
    pose, P : (3,) and (3, 3) array, the pose and its covariance

    """

    observer: str
    seen: str
    stamp: int
    pose: Array
    P: Array


@dataclass(frozen=True, slots=True, eq=False)
class StepResult:
    """
    What one step gave.

    Attributes
    ----------
    stamp : time of the step [ns]
    poses : of the robots that had this step, in the order of the robots
    joined : name and stamp of all robots in ``map``, in the order of the robots
    joint_covariance : returns the covariance of their poses in this order, (3 N, 3 N) array, until
        the next step is made
    relative_poses : of the pairs that are wanted, where both are in ``map`` and one had this step
    odometry : for each of the poses, where the robot is by its odometry, (3,) arrays
    numbered : what had no identity in the scans of the step, with the numbers it was given

    """

    stamp: int
    poses: tuple[PoseEstimate, ...]
    joined: tuple[tuple[str, int], ...]
    joint_covariance: Callable[[], Array]
    relative_poses: tuple[RelativePose, ...]
    odometry: Mapping[str, Array]
    numbered: Sequence[Scan] = ()
