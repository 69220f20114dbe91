# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Smoothing and mapping of one robot, eq. (1) of [Andersson], pose by pose.

The frame is that of the robot's first pose, unless a solution in another one is adopted. A new
pose is estimated by a filter that starts from the last solution, in a bounded time. Everything is
solved for and relinearised once in `solve_every` poses with observations, or in a tenth of all
such poses if these are more: without observations nothing is learned.
"""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
import sys

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, transform, transform_poses
from fej_slam_ros.core.models import composed_increment, G
from fej_slam_ros.core.records import Observation, UNKNOWN_POSE_COVARIANCE
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.factors import (
    concatenated, LandmarkFactors, OdometryFactors, Row, stacked, Values)
from fej_slam_ros.core.smoothing.least_squares import Solution, TOLERANCE
from fej_slam_ros.core.smoothing.newest_pose import NearMarginal, NewestPose
from fej_slam_ros.core.smoothing.problem import Problem

#: Value of `solve_every` with which the smoother never solves by itself.
NEVER = sys.maxsize
#: Default number of poses with observations between full solutions.
SOLVE_EVERY = 100
#: A solution is due when one in this many poses with observations is unsolved, so that the total
#: time of all solutions is proportional to that of the last one.
UNSOLVED_ONE_IN = 10
#: Tolerance of such a solution [m, rad]; the next one starts from it.
DUE_TOLERANCE = 1e-4


class IncrementalSmoother:
    """
    All poses of one robot and all landmarks it has observed.

    Parameters
    ----------
    solve_every : minimum number of poses with observations between full solutions

    Attributes
    ----------
    landmark_index : index of each landmark by its ID, in the order of the first observations

    """

    def __init__(
        self, observations: Iterable[Observation] = (), solve_every: int = SOLVE_EVERY
    ) -> None:
        """Start with pose 0 at the origin and the landmark observations from it."""
        self.landmark_index: dict[int, int] = {}
        self._solve_every = solve_every
        # The last solution, the poses since then, and the covariances since the last adopted one.
        self._solved = Values(np.zeros((1, 3)), np.zeros((0, 2)))
        self._poses: list[Array] = []
        self._P: list[Array] = []
        self._newest = NewestPose(
            np.zeros(3), (), self._solved.points, NearMarginal.of_pose(np.zeros((3, 3))))
        # Increment since the last of these poses, and its covariance.
        self._passed: tuple[Array, Array] | None = None
        # Poses with observations, and their number at the last attempt to solve.
        self._observed_from: list[int] = []
        self._attempted = 0
        # Factors up to the last call of problem(), and the measurements since.
        self._odometry = stacked(OdometryFactors, ())
        self._landmarks = stacked(LandmarkFactors, ())
        self._new_increments: list[Row] = []
        self._new_observations: list[Row] = []
        observations = [*observations]
        self._add_scan(observations)
        self._newest.observe(observations)

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self._solved.poses) + len(self._poses)

    @property
    def pose(self) -> Array:
        """Return the newest pose, a (3,) array, whether it is kept or not."""
        return self._newest.x

    @property
    def P(self) -> Array:
        """Return the covariance (3, 3) of the newest pose."""
        return self._newest.P

    @property
    def error(self) -> str:
        """Return a message if the newest pose lacks its observations, else ''."""
        return self._newest.error

    def add(self, u: Array, Q: Array, observations: Iterable[Observation] = ()) -> None:
        """
        Add a pose, and solve for everything if it is due.

        Parameters
        ----------
        u : (3,) array, the new pose in the frame of the newest one so far [m, m, rad]
        Q : (3, 3) array, covariance of u, positive definite
        observations : landmark observations from the new pose

        Raises
        ------
        ConvergenceError, SingularError
            The measurements contradict each other or are numerically exact; they are kept.

        """
        observations = [*observations]
        self._new_increments.append((len(self) - 1, len(self), *self._since_keyframe(u, Q)))
        self._passed = None
        self._estimate(u, Q, observations)
        self._add_scan(observations)
        if observations and self._is_solution_due():
            self.solve(DUE_TOLERANCE)

    def append(
        self, later: 'IncrementalSmoother', g: Array, Q: Array = UNKNOWN_POSE_COVARIANCE
    ) -> None:
        """
        Append the poses of a robot after a motion that is unknown from odometry.

        Parameters
        ----------
        later : poses and landmarks since then, in a frame of their own; the newest pose is kept
        g : (3,) array, the pose of that frame in this one [m, m, rad]
        Q : (3, 3) array, covariance of the motion from the last pose to g, in the frame of that
            pose; by default it is not known, and only landmarks that both have determine it

        """
        poses = transform_poses(g, later.values().poses)
        last = self._poses[-1] if self._poses else self._solved.poses[-1]
        self._append_measurements(later, between(last, poses[0]), Q)
        turn = G(last[2])
        P = turn @ Q @ turn.T  # of the poses from then on, in this frame
        self._poses += [*poses]
        self._P += [P] * len(poses)
        self._passed = None
        self._newest = NewestPose(
            compose(g, later.pose), (), np.zeros((0, 2)), NearMarginal.of_pose(P))
        if self._solve_every != NEVER:
            self.solve(DUE_TOLERANCE)

    def add_between_keyframes(
        self, u: Array, Q: Array, observations: Iterable[Observation]
    ) -> None:
        """Move by u (3,) to a pose that is not kept: observations correct only the newest pose."""
        self._newest.add(u, Q, [*observations])
        self._passed = self._since_keyframe(u, Q)

    def solve(self, tolerance: float = TOLERANCE) -> Solution:
        """
        Solve for everything and return the solution; errors as in `add`.

        `tolerance` is the largest increment of a coordinate at the end [m, rad].

        """
        problem, self._attempted = self.problem(), len(self._observed_from)
        solution = least_squares.solve(problem, self.values(), tolerance)
        values, newest = solution.values, len(self) - 1
        landmarks = np.arange(len(values.points))
        information = least_squares.information(problem, values, ())
        self._continue_from(values, NearMarginal.of(information, values, newest, landmarks))
        if self._P:
            self._P[-1] = self._newest.P
        self._restore_newest()
        return solution

    def adopt(self, values: Values, near: NearMarginal) -> None:
        """
        Continue from a solution of the first poses and landmarks that was found elsewhere.

        So are all further ones: the smoother does not solve by itself any more. `near` is the
        joint covariance of the last of these poses and of landmarks around it.

        """
        self._solve_every = NEVER
        self._continue_from(values, near)
        self._P = []
        ids, problem, solved = [*self.landmark_index], self.problem(), len(values.poses)
        landmarks, poses = problem.landmarks, np.arange(solved, len(problem.odometry.z) + 1)
        for pose, first, end in zip(
                poses.tolist(), np.searchsorted(landmarks.pose, poses),
                np.searchsorted(landmarks.pose, poses, 'right')):
            self._estimate(problem.odometry.z[pose - 1], problem.odometry.R[pose - 1], [
                Observation(ids[landmarks.target[k]], landmarks.z[k], landmarks.R[k])
                for k in range(first, end)])
        self._restore_newest()

    def problem(self) -> Problem:
        """Return all measurements."""
        self._odometry = concatenated(
            self._odometry, stacked(OdometryFactors, self._new_increments))
        self._landmarks = concatenated(
            self._landmarks, stacked(LandmarkFactors, self._new_observations))
        self._new_increments, self._new_observations = [], []
        return Problem(self._odometry, self._landmarks)

    def values(self) -> Values:
        """Return the estimate of all poses (n, 3) and landmarks (l, 2)."""
        poses = np.vstack([self._solved.poses, *self._poses])
        solved = len(self._solved.points)
        if len(self.landmark_index) == solved:
            return Values(poses, self._solved.points)
        points, factors = self._newest.points(), self.problem().landmarks
        _, firsts = np.unique(factors.target, return_index=True)
        # A landmark that the filter has forgotten is where it was first observed.
        new = [
            points[id_] if id_ in points else transform(poses[factors.pose[k]], factors.z[k])
            for id_, k in [*zip(self.landmark_index, firsts)][solved:]]
        return Values(poses, np.vstack([self._solved.points, *new]))

    def covariances(self) -> Array:
        """Return the covariance of each pose since the last adopted solution, (k, 3, 3)."""
        return np.array(self._P).reshape(-1, 3, 3)

    def _since_keyframe(self, u: Array, Q: Array) -> tuple[Array, Array]:
        """Return an increment from the newest pose as one from the last keyframe."""
        return (u, Q) if self._passed is None else composed_increment(*self._passed, u, Q)

    def _restore_newest(self) -> None:
        """Move the newest pose on from the last keyframe; observations since are lost."""
        if self._passed is not None:
            self._newest.add(*self._passed, ())

    def _estimate(self, u: Array, Q: Array, observations: Sequence[Observation]) -> None:
        self._newest.add(u, Q, observations)
        self._poses.append(self._newest.x)
        self._P.append(self._newest.P)

    def _add_scan(self, observations: Sequence[Observation]) -> None:
        """Add observations from the newest pose."""
        newest = len(self) - 1
        for observation in observations:
            index = self.landmark_index.setdefault(observation.id, len(self.landmark_index))
            self._new_observations.append((newest, index, observation.z, observation.R))
        if observations:
            self._observed_from.append(newest)

    def _append_measurements(
        self, later: 'IncrementalSmoother', u: Array, Q: Array
    ) -> None:
        """Append all measurements since a motion u (3,) with covariance Q (3, 3)."""
        problem, first, ids = later.problem(), len(self), [*later.landmark_index]
        odometry, factors = problem.odometry, problem.landmarks
        self._new_increments.append((first - 1, first, u, Q))
        self._new_increments += [
            (pose, pose + 1, z, R)
            for pose, (z, R) in enumerate(zip(odometry.z, odometry.R), start=first)]
        for pose, target, z, R in zip(
                factors.pose.tolist(), factors.target.tolist(), factors.z, factors.R):
            index = self.landmark_index.setdefault(ids[target], len(self.landmark_index))
            self._new_observations.append((first + pose, index, z, R))
        self._observed_from += (first + np.unique(factors.pose)).tolist()

    def _is_solution_due(self) -> bool:
        """Return whether too many poses with observations came after the last full solution."""
        observed = len(self._observed_from)
        solved = bisect_left(self._observed_from, len(self._solved.poses))
        # One that failed would fail again at the next pose, after as many iterations.
        new = observed - max(solved, self._attempted)
        return new >= max(self._solve_every, observed // UNSOLVED_ONE_IN)

    def _continue_from(self, values: Values, near: NearMarginal) -> None:
        self._solved, self._poses = values, []
        ids = [*self.landmark_index][:len(values.points)]
        self._newest = NewestPose(values.poses[-1], ids, values.points, near)
