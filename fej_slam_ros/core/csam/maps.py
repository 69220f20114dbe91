# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Smoothed maps of single and of joined robots: the minimum of eq. (21) of [Andersson].

[Andersson] keeps each map in its own frame and connects the frames by base nodes. Here joined
robots share the frame of the first of them, which has the same minimum; base nodes are computed
from it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.csam.base_node import (
    BaseNode, RendezvousInformation, square_root_information)
from fej_slam_ros.core.geometry import (
    Array, compose, Indices, inverse, rotation, transform, transform_poses)
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.cauchy_loss import CauchyLoss
from fej_slam_ros.core.smoothing.factors import concatenated, shifted, Values
from fej_slam_ros.core.smoothing.marginals import Information
from fej_slam_ros.core.smoothing.problem import Problem

#: Smallest variance between poses, relative to their own variances in the map, that is computed as
#: a difference: seven digits are right then.
MIN_RELATIVE_VARIANCE = 1e-8
#: Indices of two landmarks.
LandmarkPair = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """Map of one robot from its own measurements."""

    robot: str  #: name of the robot
    problem: Problem  #: all its measurements; pose 0 is fixed
    values: Values  #: poses and landmarks in the robot's own frame
    #: key of each landmark, by index; robots that share landmark IDs have equal keys
    landmarks: tuple[LandmarkKey, ...]


def landmark_index(landmarks: Sequence[Sequence[LandmarkKey]]) -> dict[LandmarkKey, int]:
    """Return the index of each landmark by each of its keys."""
    return {key: index for index, keys in enumerate(landmarks) for key in keys}


@dataclass(frozen=True, slots=True, eq=False)
class JointMap:
    """Map of joined robots in the frame of the first one, or of one robot in its own frame."""

    robots: tuple[str, ...]  #: names of the robots
    problem: Problem  #: all their measurements, with the poses robot by robot
    values: Values  #: the minimum
    first_poses: Mapping[str, int]  #: index of each robot's pose 0, by name
    origins: Mapping[str, Array]  #: (3,) arrays, each robot's pose 0 in its own frame, by name
    #: keys of each landmark, by index; more than one if landmarks were merged
    landmarks: tuple[tuple[LandmarkKey, ...], ...]
    #: chi_square, dof: cost of the minimum, and its degrees of freedom
    chi_square: float = 0.0
    dof: int = 0
    #: the result of `information` without poses within chains, once it was found
    _information: list[Information] = field(default_factory=list, init=False, repr=False)

    @classmethod
    def of(cls, local: LocalMap) -> 'JointMap':
        """Return the map of a single robot at its minimum."""
        return cls.unsolved(local).solved()

    @classmethod
    def unsolved(cls, local: LocalMap) -> 'JointMap':
        """Return the map of a single robot at its present values."""
        return cls(
            (local.robot,), local.problem, local.values, {local.robot: 0},
            {local.robot: local.values.poses[0]}, tuple((key,) for key in local.landmarks))

    def solved(
        self, loss: CauchyLoss | None = None, tolerance: float = least_squares.TOLERANCE
    ) -> 'JointMap':
        """Return the map at the minimum, starting at its values; as of `least_squares.solve`."""
        problem = self.problem
        solution = least_squares.solve(problem, self.values, tolerance, loss=loss)
        return replace(
            self, values=solution.values, chi_square=solution.cost,
            dof=problem.measured_coordinates() - solution.unknowns)

    def landmark_index(self) -> dict[LandmarkKey, int]:
        """Return the index of each landmark by each of its keys."""
        return landmark_index(self.landmarks)

    def poses_of(self, robot: str) -> range:
        """Return the indices of the poses of a robot."""
        first = self.first_poses[robot]
        later = [other for other in self.first_poses.values() if other > first]
        return range(first, min(later, default=len(self.values.poses)))

    def information(self, kept: Sequence[int] = ()) -> Information:
        """
        Return the information of all landmarks and of all poses but those within chains.

        It is found once, but for that of poses within chains that are `kept`.

        """
        if len(kept):
            return least_squares.information(self.problem, self.values, kept)
        if not self._information:
            self._information.append(least_squares.information(self.problem, self.values, ()))
        return self._information[0]

    def in_frame_of(self, pose: int) -> 'JointMap':
        """Return the map in the frame of one of its poses, which is fixed there."""
        return replace(
            self, problem=replace(self.problem, fixed_poses=(pose,)),
            values=self.values.in_frame_of(self.values.poses[pose]))

    def led_by(self, robot: str) -> 'JointMap':
        """Return the map with one of its robots as the first, in the frame of its pose 0."""
        if robot == self.robots[0]:
            return self
        first = self.first_poses[robot]
        led = self.in_frame_of(first)
        # It is the origin exactly, not but for rounding.
        led.values.poses[first] = 0.0
        return replace(led, robots=(robot, *(other for other in self.robots if other != robot)))

    def rendezvous_information(
        self, poses: Indices, information: Information | None = None
    ) -> RendezvousInformation:
        """
        Return the information about rendezvous poses (k,), in the frame of the middle one.

        The pose that is fixed in the map is appended if it is not one of them. With the
        `information` of the map, which has kept all these poses, the map is not factored again in
        that frame, unless too few digits are left of the difference of their errors.

        """
        start, = self.problem.fixed_poses
        middle = len(poses) // 2
        rows = poses if start in poses else np.append(poses, start)
        others = np.delete(rows, middle)
        centred = self.in_frame_of(int(poses[middle]))
        P = None
        if information is not None:
            P = self._relative_covariance(information, int(poses[middle]), others)
        if P is None:
            P = centred.information(rows.tolist()).joint(poses=others.tolist())
        return RendezvousInformation(
            centred.values.poses[rows], middle, rows.tolist().index(start),
            self.values.poses[start], square_root_information(P))

    def _relative_covariance(
        self, information: Information, centre: int, others: Indices
    ) -> Array | None:
        """
        Return the covariance (3 k, 3 k) of k poses in the frame of another one.

        None if it is so much smaller than their covariance in the frame of the map that it is
        rounded.

        """
        k, x = len(others), self.values.poses
        H = models.H_pose(np.tile(x[centre], (k, 1)), x[others])
        blocks = np.zeros((k, 3, k + 1, 3))
        blocks[:, :, 0], blocks[np.arange(k), :, np.arange(1, k + 1)] = H[:, :, :3], H[:, :, 3:]
        J = blocks.reshape(3 * k, 3 * (k + 1))
        P_map = information.joint(poses=[centre, *others.tolist()])
        P: Array = J @ P_map @ J.T
        least = MIN_RELATIVE_VARIANCE * P_map.diagonal().max()
        return P if P.diagonal().min(initial=least) >= least else None

    def with_merged_landmarks(
        self, pairs: Sequence[LandmarkPair], start: 'JointMap'
    ) -> 'JointMap':
        """
        Return the minimum in which the landmarks of each pair are one.

        The iteration starts at this map with other merged pairs, `start`.

        """
        label = np.arange(len(self.landmarks))
        for one, other in pairs:
            label[label == label[other]] = label[one]
        _, merged = np.unique(label, return_inverse=True)
        counts = np.bincount(merged)
        index = start.landmark_index()
        before = start.values.points[[index[keys[0]] for keys in self.landmarks]]
        points = np.column_stack([np.bincount(merged, before[:, k]) / counts for k in (0, 1)])
        landmarks = tuple(
            tuple(key for member in np.flatnonzero(merged == k) for key in self.landmarks[member])
            for k in range(len(counts)))
        factors = self.problem.landmarks
        problem = replace(
            self.problem, landmarks=replace(factors, target=merged[factors.target]))
        return replace(
            self, problem=problem, values=Values(start.values.poses, points),
            landmarks=landmarks).solved()

    def base_nodes(self, information: Information) -> dict[str, BaseNode]:
        """Return the base nodes of all robots but the first, by the information of the map."""
        base_nodes = {}
        for robot in self.robots[1:]:
            first = self.first_poses[robot]
            pose, back = self.values.poses[first], inverse(self.origins[robot])
            G = models.Phi(rotation(pose[2]) @ back[:2])
            base_nodes[robot] = BaseNode(
                compose(pose, back), G @ information.joint(poses=[first]) @ G.T)
        return base_nodes


def merged(p: JointMap, q: JointMap, base_node: Array) -> JointMap:
    """
    Return two maps as one, before it is solved for; landmarks with a common key are merged.

    `base_node` (3,) is the pose of the frame of q in that of p.

    """
    known = p.landmark_index()
    is_new = [known.keys().isdisjoint(keys) for keys in q.landmarks]
    landmarks = (*p.landmarks, *(keys for keys, new in zip(q.landmarks, is_new) if new))
    index = landmark_index(landmarks)
    landmark_of = np.array([index[keys[0]] for keys in q.landmarks], np.intp)
    n = len(p.values.poses)
    values = Values(
        np.vstack([p.values.poses, transform_poses(base_node, q.values.poses)]),
        np.vstack([p.values.points, transform(base_node, q.values.points[is_new])]))
    factors = q.problem.landmarks
    problem = replace(
        p.problem, odometry=concatenated(p.problem.odometry, shifted(q.problem.odometry, n)),
        landmarks=concatenated(p.problem.landmarks, replace(
            factors, pose=factors.pose + n, target=landmark_of[factors.target])),
        rendezvous=concatenated(p.problem.rendezvous, shifted(q.problem.rendezvous, n)))
    first_poses = {robot: n + first for robot, first in q.first_poses.items()}
    return JointMap(
        p.robots + q.robots, problem, values, {**p.first_poses, **first_poses},
        {**p.origins, **q.origins}, landmarks)
