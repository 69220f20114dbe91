# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory and map of one robot, grown pose by pose, and its frame in the team's map."""

from collections.abc import Iterator

import numpy as np

from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.csam.team_solution import SmoothedMap
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array, inverse, transform, transform_poses
from fej_slam_ros.core.records import LandmarkKey, Motion, Observation
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import Values


class RobotTrajectory:
    """
    All poses of one robot that are kept, and the newest one.

    Poses up to the last adopted solution have its covariances, later ones those of a filter.

    Attributes
    ----------
    stamps : of the poses that are kept [ns]
    frame : name of the frame of all estimates
    error : message if the newest pose or the robot's own map could not be solved for, else ''

    """

    def __init__(
        self, robot: str, stamp: int, observations: tuple[Observation, ...], solve_every: int
    ) -> None:
        self.stamps = [stamp]
        self._newest_stamp = stamp
        self.frame = own_frame(robot)
        self.error = ''
        self._robot = robot
        self._smoother = IncrementalSmoother(observations, solve_every)
        self._P_solved = np.zeros((1, 3, 3))

    def add(self, motion: Motion, observations: tuple[Observation, ...]) -> None:
        """Add the next pose and the observations from it."""
        try:
            self._smoother.add(motion.u, motion.Q, observations)
            self.error = self._smoother.error
        except NoMinimumError as error:
            self.error = str(error)
        self._newest_stamp = motion.stamp
        self.stamps.append(motion.stamp)

    def pass_by(self, motion: Motion, observations: tuple[Observation, ...]) -> None:
        """Move on without keeping a pose; the observations correct the newest pose only."""
        self._newest_stamp = motion.stamp
        self._smoother.pass_by(motion.u, motion.Q, observations)
        self.error = self._smoother.error

    def newest(self) -> PoseEstimate:
        """Return the newest pose."""
        return PoseEstimate(
            self._robot, self._newest_stamp, self.frame, self._smoother.pose, self._smoother.P)

    def poses(self) -> Array:
        """Return the poses that are kept, an (n, 3) array."""
        return self._smoother.values().poses

    def estimates(self) -> Iterator[PoseEstimate]:
        """Yield the poses that are kept, with their covariances."""
        covariances = [*self._P_solved, *self._smoother.covariances()]
        for stamp, pose, P in zip(self.stamps, self.poses(), covariances):
            yield PoseEstimate(self._robot, stamp, self.frame, pose, P)

    def is_empty(self) -> bool:
        """Return whether there are no measurements."""
        return len(self.stamps) == 1 and not self._smoother.landmark_index

    def landmark_keys(self, owner: str) -> tuple[LandmarkKey, ...]:
        """Return the keys of all landmarks; `owner` is the first part of each."""
        return tuple((owner, id_) for id_ in self._smoother.landmark_index)

    def local_map(self, owner: str) -> LocalMap:
        """Return the robot's own map; `owner` is the first part of its landmark keys."""
        values = self._smoother.values()
        to_own = inverse(values.poses[0])
        return LocalMap(
            self._robot, self._smoother.problem(),
            Values(transform_poses(to_own, values.poses), transform(to_own, values.points)),
            self.landmark_keys(owner))

    def adopt(self, solved: SmoothedMap) -> None:
        """Set the first poses and landmarks to a solution; estimate the later ones from it."""
        trajectory = solved.trajectories[self._robot]
        self.frame, self._P_solved = solved.frame, trajectory.P
        self._smoother.adopt(
            Values(trajectory.poses, solved.points[trajectory.landmarks]), trajectory.near)
