# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One robot on its way: its map, grown pose by pose, and where that lies among the others'."""

from collections.abc import Iterator

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.csam.maps import LocalMap
from fej_slam_ros.core.csam.team_solution import SmoothedMap
from fej_slam_ros.core.estimates import PoseEstimate
from fej_slam_ros.core.frame_names import own_frame
from fej_slam_ros.core.geometry import Array, between, compose, transform, transform_poses
from fej_slam_ros.core.records import Motion, Observation
from fej_slam_ros.core.smoothing.incremental import IncrementalSmoother
from fej_slam_ros.core.smoothing.least_squares import ConvergenceError, Values
from fej_slam_ros.core.smoothing.normal_equations import SingularError


class RobotTrajectory:
    """
    All poses of one robot.

    Those up to the last solution have their covariances from there. What odometry and nothing else
    says of the way since is added to that of the last of them: an upper bound until the next
    solution.

    Attributes
    ----------
    stamps : of the poses [ns]
    frame : in which they are told
    trouble : why the newest pose could not be settled, '' where it could

    """

    def __init__(
        self, robot: str, stamp: int, seen: tuple[Observation, ...], solve_every: int
    ) -> None:
        self.stamps = [stamp]
        self.frame = own_frame(robot)
        self.trouble = ''
        self._robot = robot
        self._smoother = IncrementalSmoother(seen, solve_every)
        self._Q: list[Array] = []
        # Where the robot's own frame lies in the one that it is told in.
        self._base = np.zeros(3)
        self._solved = np.zeros((1, 3, 3))
        self._P = np.zeros((3, 3))

    def add(self, motion: Motion, seen: tuple[Observation, ...]) -> None:
        """Take in the next pose, and what was seen from it."""
        before = compose(self._base, self._smoother.pose)
        self.trouble = ''
        try:
            self._smoother.add(motion.u, motion.Q, seen)
        except (ConvergenceError, SingularError) as error:
            self.trouble = str(error)
        self.stamps.append(motion.stamp)
        self._Q.append(motion.Q)
        self._P = _propagated(self._P, before, self.newest().pose, motion.Q)

    def newest(self) -> PoseEstimate:
        """Return the newest pose."""
        pose = compose(self._base, self._smoother.pose)
        return PoseEstimate(self._robot, self.stamps[-1], self.frame, pose, self._P)

    def poses(self) -> Array:
        """Return the (n, 3) array of all poses."""
        return transform_poses(self._base, self._smoother.values().poses)

    def estimates(self) -> Iterator[PoseEstimate]:
        """Yield all poses with their covariances."""
        poses = self.poses()
        for stamp, pose, P in zip(self.stamps, poses, [*self._solved, *self._since(poses)]):
            yield PoseEstimate(self._robot, stamp, self.frame, pose, P)

    def is_empty(self) -> bool:
        """Return whether nothing was measured yet."""
        return len(self.stamps) == 1 and not self._smoother.numbers

    def alone(self, owner: str) -> LocalMap:
        """Return what the robot has mapped; owner is whose numbers its landmarks have."""
        keys = tuple((owner, number) for number in self._smoother.numbers)
        return LocalMap(self._robot, self._smoother.problem(), self._smoother.values(), keys)

    def adopt(self, solved: SmoothedMap) -> None:
        """Take over a solution for all poses and landmarks up to some pose; the rest follows."""
        way = solved.ways[self._robot]
        self._base, self._solved, self.frame = way.poses[0], way.P, solved.frame
        to_own = between(self._base, np.zeros(3))
        self._smoother.take(Values(
            transform_poses(to_own, way.poses), transform(to_own, solved.points[way.landmarks])))
        *_, self._P = [self._solved[-1], *self._since(self.poses())]

    def _since(self, poses: Array) -> Iterator[Array]:
        """Yield the covariances of the poses since the last solution."""
        P, n = self._solved[-1], len(self._solved)
        for before, after, Q in zip(poses[n - 1:], poses[n:], self._Q[n - 1:]):
            P = _propagated(P, before, after, Q)
            yield P


def _propagated(P: Array, before: Array, after: Array, Q: Array) -> Array:
    """Return the covariance after a motion, eq. (4) of [Liu]."""
    Phi, G = models.Phi((after - before)[:2]), models.G(before[2])
    propagated: Array = Phi @ P @ Phi.T + G @ Q @ G.T
    return propagated
