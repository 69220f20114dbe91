# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Results of the estimator as values: poses, relative poses, landmarks and steps."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import LandmarkKey, Scan


@dataclass(frozen=True, slots=True, eq=False)
class PoseEstimate:
    """Estimated pose of a robot."""

    robot: str  #: name of the robot
    stamp: int  #: time of the pose [ns]
    #: ``map``, or ``<robot>/map`` of it or another robot while it has not joined the team
    frame: str
    pose: Array  #: (3,) array, [x, y, phi] in the frame [m, m, rad]
    P: Array  #: (3, 3) array, covariance of the pose


@dataclass(frozen=True, slots=True, eq=False)
class RelativePose:
    """Pose of a robot in the base frame of another."""

    observer: str  #: name of the robot whose base frame it is
    observed: str  #: name of the other robot
    stamp: int  #: the later of the stamps of both poses [ns]
    pose: Array  #: (3,) array, [x, y, phi] in the base frame of the observer [m, m, rad]
    P: Array  #: (3, 3) array, covariance of the relative pose


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkEstimate:
    """Estimated position of a landmark."""

    id: int  #: ID of the landmark, below -1 if it was observed without IDs
    robot: str  #: robot whose ID it is, ``''`` where all robots share IDs
    position: Array  #: (2,) array, [x, y] in the frame of the map [m]
    P: Array  #: (2, 2) array, covariance of the position [m^2]


@dataclass(frozen=True, slots=True, eq=False)
class FrameMap:
    """Confirmed landmarks of one frame; iterating yields a `LandmarkEstimate` for each."""

    frame: str  #: name of the frame
    robots: tuple[str, ...]  #: names of the robots in it
    #: (robot, ID) of each landmark, ``''`` as robot where all robots share IDs
    keys: tuple[LandmarkKey, ...]
    points: Array  #: (n, 2) array, positions [m]
    P: Array  #: (n, 2, 2) array, covariance of each position [m^2]
    tentative: int  #: number of further landmarks that are not confirmed yet

    def __len__(self) -> int:
        return len(self.keys)

    def has_shared_ids(self) -> bool:
        """Return whether there are landmarks, with IDs that all robots share."""
        return bool(self.keys) and not any(robot for robot, _ in self.keys)

    def __iter__(self) -> Iterator[LandmarkEstimate]:
        for (robot, id_), point, P in zip(self.keys, self.points, self.P):
            yield LandmarkEstimate(id_, robot, point, P)


@dataclass(frozen=True, slots=True, eq=False)
class StepResult:
    """Result of one step of the estimator."""

    stamp: int  #: time of the step [ns]
    #: poses of the robots that took part in the step, in the order of the robots
    poses: tuple[PoseEstimate, ...]
    #: name and stamp of the pose of each robot in ``map``, in the order of the robots
    joined: tuple[tuple[str, int], ...]
    #: (3,) array for each robot of `poses`, its pose by odometry alone
    odometry: Mapping[str, Array]
    #: scans with the observations that came without IDs and the IDs they were given
    associated: Sequence[Scan] = ()
