# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
One robot's smoothing and mapping, eq. (1) of [Andersson], grown pose by pose.

The map is in the frame of the robot's first pose. A new pose is predicted by odometry and settled
together with the few before it, the rest of the map being held; that takes equally long however
large the map is. Every so many poses everything is solved for and linearised anew.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from fej_slam_ros.core.geometry import Array, between, compose, Indices, transform
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.least_squares import (
    concatenated, LandmarkFactors, OdometryFactors, Problem, Solution, Values)
from fej_slam_ros.core.smoothing.marginals import Information

#: The number of a landmark and how it was seen.
SeenLandmark = tuple[int, Observation]

#: Poses that a new one is settled with.
WINDOW = 10
#: They are settled when none of them moves further [m, rad]; the whole map is solved for later.
SETTLED = 1e-4
#: Everything is solved for when so many poses have come since it last was.
SOLVE_EVERY = 100


class IncrementalSmoother:
    """
    All poses of one robot and all landmarks that it saw, in the frame of its pose 0.

    Attributes
    ----------
    numbers : number of each landmark by its id, in the order in which they were first seen

    """

    def __init__(
        self, observations: Iterable[Observation] = (), solve_every: int = SOLVE_EVERY
    ) -> None:
        """
        Begin with pose 0 at the origin.

        Parameters
        ----------
        observations : what was seen from there
        solve_every : everything is solved for when so many poses have come since it last was

        """
        self.numbers: dict[int, int] = {}
        self._solve_every, self._unsolved = solve_every, 0
        # What was measured: since some pose as it came, and in arrays as far as it was asked for.
        self._left_out = self._looked = 0
        self._ways: list[tuple[Array, Array]] = []
        self._scans: list[list[SeenLandmark]] = []
        self._increments, self._observations = _increments(0, []), _observations(0, [])
        self._first_seen: list[int] = []
        self._poses: list[Array] = [np.zeros(3)]
        self._points: list[Array] = []
        self._see(observations)

    @property
    def pose(self) -> Array:
        """Return the (3,) array of the newest pose."""
        return self._poses[-1]

    def add(self, u: Array, Q: Array, observations: Iterable[Observation] = ()) -> None:
        """
        Add a pose, and settle it.

        Parameters
        ----------
        u : (3,) array, the new pose in the frame of the newest one so far [m, m, rad]
        Q : (3, 3) array, covariance of u, positive definite
        observations : what was seen from the new pose

        Raises
        ------
        ConvergenceError, SingularError
            The measurements contradict each other, or are too exact to be solved for; they are
            kept all the same.

        """
        self._ways.append((u, Q))
        self._poses.append(compose(self._poses[-1], u))
        self._see(observations)
        self._unsolved += 1
        if self._unsolved >= self._solve_every:
            self.solve()
        elif self._scans[-1]:
            self._settle()

    def solve(self) -> Solution:
        """Solve for everything and return the solution; errors as in `add`."""
        solution = least_squares.solve(self.problem(), self.values())
        self.take(solution.values)
        return solution

    def take(self, values: Values) -> None:
        """
        Take values that were solved for elsewhere, of all poses and landmarks up to then.

        What came since moves rigidly with the last of these poses.

        """
        n, points = len(values.poses), len(values.points)
        old, new = self._poses[n - 1], values.poses[-1]
        later = [compose(new, between(old, pose)) for pose in self._poses[n:]]
        self._poses = [*values.poses, *later]
        self._points = [*values.points, *(
            transform(new, transform(between(old, np.zeros(3)), point))
            for point in self._points[points:])]
        self._unsolved = len(later)

    def problem(self) -> Problem:
        """Return all that was measured, with poses and landmarks by number."""
        ways, scans = len(self._increments.u), self._looked
        self._increments = concatenated(
            self._increments, _increments(ways, self._ways[ways - self._left_out:]))
        self._observations = concatenated(
            self._observations, _observations(scans, self._scans[scans - self._left_out:]))
        self._looked = len(self._poses)
        self._leave_out(max(0, self._looked - 1 - WINDOW))
        return Problem(self._increments, self._observations)

    def values(self) -> Values:
        """Return the estimate of all poses (n, 3) and landmarks (l, 2), by number."""
        return Values(np.array(self._poses), np.array(self._points).reshape(-1, 2))

    def information(self) -> Information:
        """Return what is known of all poses and landmarks, linearised at the estimate."""
        return least_squares.information(self.problem(), self.values())

    def _see(self, observations: Iterable[Observation]) -> None:
        """Keep what the newest pose saw; a landmark that is new starts where it is seen."""
        newest = len(self._poses) - 1
        scan = []
        for observation in observations:
            if observation.id not in self.numbers:
                self.numbers[observation.id] = len(self._points)
                self._points.append(transform(self._poses[newest], observation.z))
                self._first_seen.append(newest)
            scan.append((self.numbers[observation.id], observation))
        self._scans.append(scan)

    def _settle(self) -> None:
        """Solve for the newest poses and the landmarks that none before them saw."""
        first = max(0, len(self._poses) - 1 - WINDOW)
        problem, landmarks = self._since(first)
        start = Values(
            np.array(self._poses[first:]), np.array([self._points[f] for f in landmarks]))
        values = least_squares.solve(problem, start, SETTLED).values
        self._poses[first:] = values.poses
        for landmark, point in zip(landmarks, values.points):
            self._points[landmark] = point

    def _leave_out(self, first: int) -> None:
        """Keep as it came only what was measured from a pose on."""
        del self._ways[:first - self._left_out], self._scans[:first - self._left_out]
        self._left_out = first

    def _since(self, first: int) -> tuple[Problem, Indices]:
        """
        Return what was measured from a pose on, and the landmarks seen since.

        Poses and landmarks have numbers of their own there. The first pose is fixed, and so are
        the landmarks that were seen before it.

        """
        kept = first - self._left_out
        observations = _observations(0, self._scans[kept:])
        landmarks, numbers = np.unique(observations.landmark, return_inverse=True)
        fixed = [
            number for number, landmark in enumerate(landmarks)
            if self._first_seen[landmark] < first]
        return Problem(
            _increments(0, self._ways[kept:]), replace(observations, landmark=numbers),
            fixed_landmarks=fixed), landmarks


def _increments(first: int, ways: Sequence[tuple[Array, Array]]) -> OdometryFactors:
    """Return ways from pose to pose, of which the first begins at a pose of some number."""
    begin = np.arange(first, first + len(ways))
    return OdometryFactors(
        begin, begin + 1, np.array([u for u, _ in ways]).reshape(-1, 3),
        np.array([Q for _, Q in ways]).reshape(-1, 3, 3))


def _observations(first: int, scans: Sequence[Sequence[SeenLandmark]]) -> LandmarkFactors:
    """Return what poses saw, of which the first has some number."""
    numbered = list(enumerate(scans, first))
    seen = [observation for _, scan in numbered for _, observation in scan]
    return LandmarkFactors(
        np.array([pose for pose, scan in numbered for _ in scan], np.intp),
        np.array([landmark for _, scan in numbered for landmark, _ in scan], np.intp),
        np.array([s.z for s in seen]).reshape(-1, 2),
        np.array([s.R for s in seen]).reshape(-1, 2, 2))
