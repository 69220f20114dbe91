# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Smoothing and mapping of one robot, eq. (1) of [Andersson], pose by pose.

The frame is that of the robot's first pose. A new pose is predicted from odometry and optimised
over a window of recent poses with the older map fixed, which takes constant time. Everything is
solved for and relinearised once in `solve_every` poses with observations, or in a tenth of all
such poses if these are more: without observations nothing is learned.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Iterable
from dataclasses import replace
from itertools import chain

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, Indices, inverse, transform
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.least_squares import (
    concatenated, LandmarkFactors, OdometryFactors, Problem, Row, shifted, Solution, stacked,
    Values)
from fej_slam_ros.core.smoothing.marginals import Information

#: Poses before the newest one that are optimised with it.
WINDOW_POSES = 10
#: Largest last increment in the window [m, rad]; the next full solution is exact.
WINDOW_TOLERANCE = 1e-4
#: Default number of poses with observations between full solutions, and the share of all of them
#: that may be unsolved: the time of all solutions is then proportional to that of the last one.
SOLVE_EVERY = 100
UNSOLVED_SHARE = 10


class IncrementalSmoother:
    """
    All poses of one robot and all landmarks it has observed, in the frame of its pose 0.

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
        # Number of poses of the last full solution, and the poses with observations.
        self._solved = 1
        self._observed_from: list[int] = []
        # Factors up to the last call of problem(), and the measurements since.
        self._odometry = stacked(OdometryFactors, ())
        self._landmarks = stacked(LandmarkFactors, ())
        self._new_increments: list[Row] = []
        self._new_observations: list[Row] = []
        # Measurements in the window.
        self._increments: deque[Row] = deque(maxlen=WINDOW_POSES)
        self._scans: deque[list[Row]] = deque(maxlen=WINDOW_POSES + 1)
        self._first_observed_from: list[int] = []
        self._poses: list[Array] = [np.zeros(3)]
        self._points: list[Array] = []
        self._add_scan(observations)

    @property
    def pose(self) -> Array:
        """Return the newest pose, a (3,) array."""
        return self._poses[-1]

    def add(self, u: Array, Q: Array, observations: Iterable[Observation] = ()) -> None:
        """
        Add a pose and optimise the window, or everything if it is due.

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
        increment = len(self._poses) - 1, len(self._poses), u, Q
        self._increments.append(increment)
        self._new_increments.append(increment)
        self._poses.append(compose(self._poses[-1], u))
        self._add_scan(observations)
        if self._scans[-1]:
            if self._is_solution_due():
                self.solve()
            else:
                self._solve_window()

    def solve(self) -> Solution:
        """Solve for everything and return the solution; errors as in `add`."""
        solution = least_squares.solve(self.problem(), self.values())
        self.adopt(solution.values)
        return solution

    def adopt(self, values: Values) -> None:
        """
        Set the estimate of the first poses and landmarks to values solved for elsewhere.

        Later poses and landmarks move rigidly with the last of these poses.

        """
        n, points = len(values.poses), len(values.points)
        old, new = self._poses[n - 1], values.poses[-1]
        later = [compose(new, between(old, pose)) for pose in self._poses[n:]]
        self._poses = [*values.poses, *later]
        self._points = [*values.points, *(
            transform(new, transform(inverse(old), point))
            for point in self._points[points:])]
        self._solved = n

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
        return Values(np.array(self._poses), np.array(self._points).reshape(-1, 2))

    def information(self) -> Information:
        """Return the information of all poses and landmarks, linearised at the estimate."""
        return least_squares.information(self.problem(), self.values())

    def _add_scan(self, observations: Iterable[Observation]) -> None:
        """Add observations from the newest pose; they initialise new landmarks."""
        newest = len(self._poses) - 1
        scan = []
        for observation in observations:
            if observation.id not in self.landmark_index:
                self.landmark_index[observation.id] = len(self._points)
                self._points.append(transform(self._poses[newest], observation.z))
                self._first_observed_from.append(newest)
            scan.append((
                newest, self.landmark_index[observation.id], observation.z, observation.R))
        self._scans.append(scan)
        self._new_observations += scan
        if scan:
            self._observed_from.append(newest)

    def _is_solution_due(self) -> bool:
        """Return whether so many poses with observations are not in the last full solution."""
        observed = len(self._observed_from)
        unsolved = observed - bisect_left(self._observed_from, self._solved)
        return unsolved >= max(self._solve_every, observed // UNSOLVED_SHARE)

    def _solve_window(self) -> None:
        """Solve for the newest poses and the landmarks first observed from them."""
        first = max(0, len(self._poses) - 1 - WINDOW_POSES)
        problem, landmarks = self._window_problem(first)
        start = Values(
            np.array(self._poses[first:]), np.array([self._points[f] for f in landmarks]))
        values = least_squares.solve(problem, start, WINDOW_TOLERANCE).values
        self._poses[first:] = values.poses
        for landmark, point in zip(landmarks, values.points):
            self._points[landmark] = point

    def _window_problem(self, first: int) -> tuple[Problem, Indices]:
        """
        Return the measurements in the window from pose `first` on, and its landmarks.

        Poses and landmarks are indexed within the window. The first pose is fixed, and so are the
        landmarks first observed before it.

        """
        observations = stacked(LandmarkFactors, chain.from_iterable(self._scans))
        landmarks, rows = np.unique(observations.target, return_inverse=True)
        fixed = [
            row for row, landmark in enumerate(landmarks)
            if self._first_observed_from[landmark] < first]
        return Problem(
            shifted(stacked(OdometryFactors, self._increments), -first),
            replace(observations, pose=observations.pose - first, target=rows),
            fixed_landmarks=fixed), landmarks
