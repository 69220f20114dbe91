# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trajectory and map of one robot, grown pose by pose, and its frame in the team's map."""

from collections.abc import Iterator

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.csam.team_solution import SmoothedMap
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.gauss_newton import NoMinimumError
from fej_slam_ros.core.geometry import Array, compose, inverse, transform, transform_poses
from fej_slam_ros.core.records import LandmarkKey, Motion, Observation
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import Values


class RobotTrajectory:
    """
    All poses of one robot.

    Poses up to the last solution have its covariances. Later poses add the covariance of odometry
    to the last of these: an upper bound until the next solution.

    Attributes
    ----------
    stamps : of the poses [ns]
    frame : name of the frame of all estimates
    error : message if the newest pose could not be optimised, else ''

    """

    def __init__(
        self, robot: str, stamp: int, observations: tuple[Observation, ...], solve_every: int
    ) -> None:
        self.stamps = [stamp]
        self.frame = own_frame(robot)
        self.error = ''
        self._robot = robot
        self._smoother = IncrementalSmoother(observations, solve_every)
        self._Q: list[Array] = []
        # Pose of the robot's own frame in `frame`.
        self._base = np.zeros(3)
        self._P_solved, self._P = np.zeros((1, 3, 3)), np.zeros((3, 3))

    def add(self, motion: Motion, observations: tuple[Observation, ...]) -> None:
        """Add the next pose and the observations from it."""
        before = compose(self._base, self._smoother.pose)
        self.error = ''
        try:
            self._smoother.add(motion.u, motion.Q, observations)
        except NoMinimumError as error:
            self.error = str(error)
        self.stamps.append(motion.stamp)
        self._Q.append(motion.Q)
        self._P = _propagated(self._P, before, self.newest().pose, motion.Q)

    def newest(self) -> PoseEstimate:
        """Return the newest pose."""
        pose = compose(self._base, self._smoother.pose)
        return PoseEstimate(self._robot, self.stamps[-1], self.frame, pose, self._P)

    def poses(self) -> Array:
        """Return all poses, an (n, 3) array."""
        return transform_poses(self._base, self._smoother.values().poses)

    def estimates(self) -> Iterator[PoseEstimate]:
        """Yield all poses with their covariances."""
        poses = self.poses()
        covariances = [*self._P_solved, *self._covariances_since_solution(poses)]
        for stamp, pose, P in zip(self.stamps, poses, covariances):
            yield PoseEstimate(self._robot, stamp, self.frame, pose, P)

    def is_empty(self) -> bool:
        """Return whether there are no measurements."""
        return len(self.stamps) == 1 and not self._smoother.landmark_index

    def landmark_keys(self, owner: str) -> tuple[LandmarkKey, ...]:
        """Return the keys of all landmarks; `owner` is the first part of each."""
        return tuple((owner, id_) for id_ in self._smoother.landmark_index)

    def local_map(self, owner: str) -> LocalMap:
        """Return the robot's own map; `owner` is the first part of its landmark keys."""
        return LocalMap(
            self._robot, self._smoother.problem(), self._smoother.values(),
            self.landmark_keys(owner))

    def adopt(self, solved: SmoothedMap) -> None:
        """Set the first poses and landmarks to a solution; later ones move with its last pose."""
        trajectory = solved.trajectories[self._robot]
        self._base, self._P_solved = trajectory.poses[0], trajectory.P
        self.frame = solved.frame
        to_own = inverse(self._base)
        self._smoother.adopt(Values(
            transform_poses(to_own, trajectory.poses),
            transform(to_own, solved.points[trajectory.landmarks])))
        *_, self._P = [self._P_solved[-1], *self._covariances_since_solution(self.poses())]

    def _covariances_since_solution(self, poses: Array) -> Iterator[Array]:
        P, n = self._P_solved[-1], len(self._P_solved)
        for before, after, Q in zip(poses[n - 1:], poses[n:], self._Q[n - 1:]):
            P = _propagated(P, before, after, Q)
            yield P


def _propagated(P: Array, before: Array, after: Array, Q: Array) -> Array:
    """Return the covariance after a motion, eq. (4) of [Liu]."""
    Phi, G = models.Phi((after - before)[:2]), models.G(before[2])
    return Phi @ P @ Phi.T + G @ Q @ G.T
