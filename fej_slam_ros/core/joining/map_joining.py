# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joining a frame group to another one, e.g. the team, by the variables that both share.

Their filters have run separately so far. :mod:`fej_slam_ros.core.joining.frame_fit` finds the pose
of one frame in the other, and :mod:`fej_slam_ros.core.joining.joined_state` the state of both.
"""

from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy

import numpy as np

from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.state import (
    JointState, part_of, position_indices, Robot, Variables)
from fej_slam_ros.core.geometry import Array, perpendicular
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.joining.change_of_frame import in_frame_of
from fej_slam_ros.core.joining.frame_fit import (
    determine_heading, fit, FrameFit, shared_variables)
from fej_slam_ros.core.joining.joined_state import joined_state
from fej_slam_ros.core.joining.outlying_landmarks import (
    outlying_landmarks, single_observation_failure)
from fej_slam_ros.core.pieces import EndedError
from fej_slam_ros.core.point_consensus import OUTLIER_D2
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.sentences import counted

#: Factor on the largest standard deviation of the heading where the fit leaves out a landmark that
#: was observed once.
SINGLE_OBSERVATION_FACTOR = 2.0


class MapJoiner:
    """
    Joins the state of one filter to that of another if the shared variables allow it.

    Parameters
    ----------
    min_landmarks : minimum number of shared landmarks and rendezvous points
    probability : chi-square probability with which a correct join is accepted
    max_heading_sigma : largest standard deviation of the heading of g [rad]. Beyond it the
        first-order approximation fails for distant landmarks: 60 runs with 20 landmarks gave
        NEES/3 of 1.27 at 0.05, 1.31 at 0.1, 1.36 at 0.2 and 21 at 1

    """

    def __init__(
        self, min_landmarks: int, probability: float, max_heading_sigma: float = 0.1
    ) -> None:
        self._min_landmarks = min_landmarks
        self._tail = 1.0 - probability
        self._max_heading_sigma = max_heading_sigma

    def join(self, team: Filter, group: Filter) -> JoinFailure | None:
        """Join all variables of the group to the team; return the reason if that fails."""
        landmarks = len(team.state.landmarks.keys() & group.state.landmarks.keys())
        points = len(team.state.rendezvous_points.keys() & group.state.rendezvous_points.keys())
        shared = counted(landmarks, 'shared landmark')
        if points:
            shared += f' and {counted(points, "observation")} of robots'
        if landmarks + points < self._min_landmarks:
            return JoinFailure(f'{shared}, needs {self._min_landmarks}')
        # The conditions of a join cost little however large the maps are.
        _, theirs = shared_variables(team.state, group.state)
        robot = most_certain_robot(group.state, theirs)
        local = _in_frame_of(robot, group, theirs)
        if not determine_heading(team.state, local):
            return JoinFailure(f'{shared} are at one place, which determines no heading')
        found = fit(team.state, local)
        failure = self._contradiction(team, local, found, shared)
        if failure is not None:
            return failure
        try:
            _join(team, _in_frame_of(robot, group, group.state.variables()), found.pose)
        except EndedError:
            return JoinFailure('the process ended before it could join')
        return None

    def misfits(self, team: Filter, group: Filter, most: int) -> Sequence[LandmarkKey]:
        """
        Return shared landmarks without which the others fit; none if these are more than `most`.

        One after the other, that without which chi-square is least.

        """
        _, theirs = shared_variables(team.state, group.state)
        local = _in_best_frame(group, theirs)
        left_out: list[LandmarkKey] = []
        while not (found := fit(team.state, local, left_out)).is_consistent(self._tail):
            if len(left_out) == most:
                return []
            left_out.append(found.worst_landmark())
        return left_out

    def _contradiction(
        self, team: Filter, local: JointState, found: FrameFit, shared: str
    ) -> JoinFailure | None:
        """Return why a fit to the shared variables, which are named in words, joins no frames."""
        count = len(found.shared)
        if not found.is_consistent(self._tail):
            outlying = outlying_landmarks(team.state, local, self._tail)
            if outlying and count - len(outlying) >= self._min_landmarks:
                return JoinFailure(
                    f'{len(outlying)} of {shared} contradict the others',
                    outlying_landmarks=outlying)
            worst, drop = found.worst_rendezvous_point()
            # The remaining ones must determine g.
            is_outlier = drop > OUTLIER_D2 and count > self._min_landmarks
            return JoinFailure(
                f'{shared} do not fit: chi-square {found.chi2:.1f}, limit'
                f' {found.limit(self._tail):.1f}', outlier=worst if is_outlier else None, d2=drop)
        sigma = found.heading_sigma()
        if sigma > self._max_heading_sigma:
            # The uncertainty of the global heading of the team is irrelevant.
            sigma = min(sigma, fit(_in_best_frame(team, found.shared), local).heading_sigma())
        if sigma > self._max_heading_sigma:
            return JoinFailure(
                f'{shared} determine the heading to {sigma:.2f} rad only, needs'
                f' {self._max_heading_sigma}')
        return single_observation_failure(
            team.state, local, SINGLE_OBSERVATION_FACTOR * self._max_heading_sigma)

    def apply_pose_prior(
        self, team: Filter, group: Filter, name: str, pose: Array, P: Array
    ) -> bool:
        """
        Add a robot of a group to the team by a pose prior; `join_via_robot` adds the rest.

        The prior is the robot's pose (3,) in the team's frame with covariance P (3, 3). Returns
        whether it fits the shared landmarks; otherwise the states are unchanged.

        """
        state = deepcopy(team.state)
        state.insert_robot(name, group.state.robots[name].stamp, pose, P)
        if self._accepted(state, group.state) is None:
            return False
        team.state = state
        return True

    def join_via_robot(self, team: Filter, group: Filter, name: str) -> bool:
        """
        Join a group to the team, whose state already contains one of its robots.

        The team's information on that robot must be independent of the group's. Returns whether
        the group has joined. If not, its map does not fit or the heading of the robot is too
        uncertain; the robot is then removed from the group, whose map may join later.

        """
        robot = group.state.robots[name]
        if group.state.variables() == [robot]:
            return True
        found = self._accepted(team.state, group.state)
        if found is not None and found.heading_sigma() <= self._max_heading_sigma:
            with suppress(EndedError):
                _join(team, group.state, found.pose)
                return True
        group.state.remove(robot)
        return False

    def _accepted(self, team: JointState, group: JointState) -> FrameFit | None:
        """Return the fit of a group if it passes the chi-square test."""
        found = fit(team, group)
        return found if found.is_consistent(self._tail) else None


def most_certain_robot(state: JointState, points: Variables) -> Robot | None:
    """
    Return the robot whose heading is known best relative to the turn of some points, if any.

    In its frame the error that is linearised, a rotation of these points, is the least.

    """
    robots = [*state.robots.values()]
    if len(robots) < 2:
        return next(iter(robots), None)
    positions = state.estimates_of(position_indices(points))
    offsets = positions - positions.mean(axis=0)
    # The turn of the points is w^T dp, for their errors dp.
    w = perpendicular(offsets).ravel() / (np.vdot(offsets, offsets) or 1.0)
    P, n = state.marginal([*robots, *points]), 3 * len(robots)
    headings = np.arange(2, n, 3)
    # But for the variance of the turn itself, which is the same for all robots.
    return robots[int(np.argmin(P[headings, headings] - 2.0 * P[headings, n:] @ w))]


def _join(team: Filter, group: JointState, g: Array) -> None:
    """Join a group, at pose g (3,) in the frame of the team, whose policy changes with it."""
    policy = team.linearization.of_joining_maps()
    team.state, team.linearization = joined_state(team.state, group, g, policy), policy


def _in_best_frame(filter_: Filter, points: Variables) -> JointState:
    """Return some points in the frame of the most certain robot."""
    return _in_frame_of(most_certain_robot(filter_.state, points), filter_, points)


def _in_frame_of(robot: Robot | None, filter_: Filter, variables: Variables) -> JointState:
    """
    Return some variables in the frame of a robot, if any: the origin may be far away.

    The robot is added if it is not one of them.

    """
    if robot is None:
        return part_of(filter_.state, variables)
    part = part_of(filter_.state, variables if robot in variables else [robot, *variables])
    return in_frame_of(part, part.robots[robot.name], filter_.linearization)
