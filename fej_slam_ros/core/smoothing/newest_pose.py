# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
EKF of a robot's newest pose between solutions.

It starts from the joint covariance of the last pose that was solved for and of the landmarks
around it, and takes the measurements since then, in a time that is bounded. Its errors are the
invariant ones, and its updates iterated, as loops may close far from the start.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import Invariant
from fej_slam_ros.core.ekf.state import (
    JointState, Landmark, landmark_estimates, Robot)
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.records import Motion, Observation, Scan
from fej_slam_ros.core.smoothing.factors import Values
from fej_slam_ros.core.smoothing.marginals import Information

#: Number of landmarks nearest to a pose that the filter continues with. When it has twice as many
#: it forgets the others. A forgotten landmark that is observed again starts as a new one: its
#: earlier observations are ignored, and none is used twice.
MAX_FILTER_LANDMARKS = 100
#: Gauss-Newton iterations of an update.
UPDATE_ITERATIONS = 3
#: Name of the robot in the state of the filter, which has no other.
FILTER_ROBOT = 'robot'


@dataclass(frozen=True, slots=True, eq=False)
class NearMarginal:
    """Joint covariance of a pose and of some landmarks around it."""

    landmarks: Indices  #: (k,) array, indices of the landmarks among those of the robot
    P: Array  #: (3 + 2 k, 3 + 2 k) array, in the frame of the estimate

    @classmethod
    def of_pose(cls, P: Array) -> 'NearMarginal':
        """Return that of a pose with covariance P (3, 3), without landmarks."""
        return cls(np.empty(0, np.intp), P)

    @classmethod
    def of(
        cls, information: Information, values: Values, pose: int, landmarks: Indices
    ) -> 'NearMarginal':
        """
        Return that of a pose, by its index, and of the nearest landmarks.

        `landmarks` (l,) are the indices in the values of the robot's landmarks, in its order.

        """
        away = values.points[landmarks] - values.poses[pose, :2]
        near = np.sort(np.argsort(np.hypot(*away.T), kind='stable')[:MAX_FILTER_LANDMARKS])
        return cls(near, information.joint([pose], landmarks[near].tolist()))

    def turned(self, C: Array) -> 'NearMarginal':
        """Return the same in a frame in which directions are C (2, 2) times those of this one."""
        T = np.eye(len(self.P))
        T[:2, :2] = C
        T[3:, 3:] = np.kron(np.eye(len(self.landmarks)), C)
        return NearMarginal(self.landmarks, T @ self.P @ T.T)

    def renumbered(self, before: Indices, after: Indices) -> 'NearMarginal':
        """Return that of a robot with other landmarks, both given by their indices in the map."""
        number = {index: k for k, index in enumerate(after.tolist())}
        in_map = before[self.landmarks]
        is_kept = np.isin(in_map, after)
        states = np.r_[np.ones(3, np.bool_), is_kept.repeat(2)]
        return NearMarginal(
            np.array([number[index] for index in in_map[is_kept].tolist()], np.intp),
            self.P[np.ix_(states, states)])


class NewestPose:
    """
    The newest pose of a robot, by a filter.

    Parameters
    ----------
    pose : (3,) array, the pose to start with
    ids : IDs of all landmarks that are solved for
    points : (l, 2) array, their positions
    near : joint covariance of the pose and of the landmarks that the filter continues with

    Attributes
    ----------
    error : message if observations from the newest pose could not be used, else ''

    """

    def __init__(
        self, pose: Array, ids: Sequence[int], points: Array, near: NearMarginal
    ) -> None:
        self.error = ''
        self._filter = _filter(pose, ids, points, near)

    @property
    def _robot(self) -> Robot:
        return self._filter.state.robots[FILTER_ROBOT]

    @property
    def x(self) -> Array:
        """Return the pose, a (3,) array."""
        return self._filter.state.estimate(self._robot)

    @property
    def P(self) -> Array:
        """Return its covariance (3, 3)."""
        return self._filter.state.marginal([self._robot])

    def points(self) -> dict[int, Array]:
        """Return the position (2,) of each landmark that the filter has, by ID."""
        state = self._filter.state
        return {id_: state.estimate(landmark) for (_, id_), landmark in state.landmarks.items()}

    def add(self, u: Array, Q: Array, observations: Sequence[Observation]) -> None:
        """Move by u (3,) with covariance Q (3, 3); use the observations from the new pose."""
        self._filter.predict(Motion(FILTER_ROBOT, self._robot.stamp + 1, u, Q))
        self.observe(observations)

    def observe(self, observations: Sequence[Observation]) -> None:
        """Use observations from the present pose; if P is broken they wait for a solution."""
        self.error = ''
        if not observations:
            return
        self._forget_distant()
        associations = self._filter.start_landmarks(
            [Scan(FILTER_ROBOT, self._robot.stamp, tuple(observations))])
        x, P = self.x, self.P
        try:
            self._filter.update(associations)
        except ArithmeticError as error:
            self.error = str(error)
            self._filter = _filter(x, (), np.zeros((0, 2)), NearMarginal.of_pose(P))

    def _forget_distant(self) -> None:
        state = self._filter.state
        landmarks = [*state.landmarks.values()]
        if len(landmarks) > 2 * MAX_FILTER_LANDMARKS:
            points, _ = landmark_estimates(state, landmarks)
            order = np.argsort(np.hypot(*(points - self.x[:2]).T), kind='stable')
            state.remove_all([landmarks[k] for k in order[MAX_FILTER_LANDMARKS:].tolist()])


def _filter(pose: Array, ids: Sequence[int], points: Array, near: NearMarginal) -> Filter:
    """Return the filter that starts with a pose and the landmarks around it."""
    covariance = Covariance()
    slot, *slots = covariance.insert(near.P).split([3] + [2] * len(near.landmarks))
    landmarks = [
        Landmark(('', ids[k]), landmark_slot, FILTER_ROBOT, 0)
        for k, landmark_slot in zip(near.landmarks.tolist(), slots)]
    x = np.concatenate([pose, points[near.landmarks].ravel()])
    state = JointState([Robot(FILTER_ROBOT, slot, 0), *landmarks], x, x.copy(), covariance)
    return Filter(state, Invariant(), Gate(1.0), iterations=UPDATE_ITERATIONS)
