# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Collaborative smoothing and mapping, section IV of [Andersson]: maps of robots that met become one.

Each robot has smoothed its own way and map in a frame of its own. Where robots saw each other, or
share numbers of landmarks, base nodes tell where the frames lie; landmarks that stand in several
maps are found to be one; and the minimum of eq. (21) over all poses and landmarks is the result.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.least_squares import Problem, Values
from fej_slam_ros.core.records import LandmarkKey


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """
    What one robot has mapped alone.

    Attributes
    ----------
    robot : its name
    problem : all that it measured; pose 0 is fixed
    values : the minimum, in a frame of the robot's own
    landmarks : key of each landmark, by number; where robots share numbers the keys are equal

    """

    robot: str
    problem: Problem
    values: Values
    landmarks: tuple[LandmarkKey, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """
    A robot seen by a robot, a rendezvous-measurement of [Andersson].

    Attributes
    ----------
    seer, pose : name of the robot that saw, and number of its pose
    seen, seen_pose : name of the robot that was seen, and number of its pose
    z : (2,) array, position of the seen robot in the base frame of the seer [m]
    R : (2, 2) array, covariance of z [m^2]

    """

    seer: str
    pose: int
    seen: str
    seen_pose: int
    z: Array
    R: Array


@dataclass(frozen=True, slots=True, eq=False)
class BaseNode:
    """Pose (3,) of a robot's own frame in that of the joint map, with its covariance P (3, 3)."""

    pose: Array
    P: Array


@dataclass(frozen=True, slots=True, eq=False)
class JointMap:
    """
    The map of robots that are joined, in the frame of the first of them; of one alone, its own.

    Attributes
    ----------
    robots : their names
    problem : all that they measured; the poses go robot by robot
    values : the minimum
    first_poses : number of each robot's pose 0, in the order of the robots
    landmarks : what each landmark is called, by number; several names where maps share it
    base_nodes : of the other robots, by name
    chi_square : cost of the minimum, and its degrees of freedom

    """

    robots: tuple[str, ...]
    problem: Problem
    values: Values
    first_poses: tuple[int, ...]
    landmarks: tuple[tuple[LandmarkKey, ...], ...]
    base_nodes: Mapping[str, BaseNode]
    chi_square: float
    dof: int


@dataclass(frozen=True, slots=True)
class NotJoined:
    """Why two robots that met, or that share landmarks, were not joined, for users to read."""

    robots: tuple[str, str]
    reason: str


def join(
    maps: Sequence[LocalMap], meetings: Sequence[Meeting]
) -> tuple[list[JointMap], list[NotJoined]]:
    """Return the maps after joining, of which each robot is part of one, and what failed."""
    raise NotImplementedError
