# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Maps of robots, smoothed alone or together: what was measured, and the minimum of eq. (21).

[Andersson] keeps each map in its own frame and ties the frames by base nodes. Here the poses and
landmarks of robot Q are expressed in the frame of robot P as soon as they are joined: that is the
same minimum, of which the pose of Q's frame is read off in the end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from fej_slam_ros.core import models
from fej_slam_ros.core.csam.base_node import (
    BaseNode, RendezvousInformation, square_root_information)
from fej_slam_ros.core.geometry import (
    Array, between, compose, Indices, rotation, transform, transform_poses)
from fej_slam_ros.core.records import LandmarkKey
from fej_slam_ros.core.smoothing import least_squares
from fej_slam_ros.core.smoothing.least_squares import (
    concatenated, LandmarkFactors, OdometryFactors, Problem, RendezvousFactors, Values)
from fej_slam_ros.core.smoothing.marginals import Information

#: Numbers of two landmarks.
LandmarkPair = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class LocalMap:
    """
    What one robot has mapped alone.

    Attributes
    ----------
    robot : its name
    problem : all that it measured; pose 0 is fixed
    values : the minimum, in a frame of the robot's own
    landmarks : key of each landmark, by number; where robots share numbers the keys are equal

    """

    robot: str
    problem: Problem
    values: Values
    landmarks: tuple[LandmarkKey, ...]


@dataclass(frozen=True, slots=True, eq=False)
class JointMap:
    """
    The map of robots that are joined, in the frame of the first of them; of one alone, its own.

    Attributes
    ----------
    robots : their names
    problem : all that they measured; the poses go robot by robot
    values : the minimum
    first_poses : number of each robot's pose 0, by name
    origins : (3,) arrays, each robot's pose 0 in the robot's own frame, by name
    landmarks : what each landmark is called, by number; several names where maps share it
    chi_square : cost of the minimum
    dof : degrees of freedom of chi-square
    base_nodes : of the other robots, by name, where they have been asked for

    """

    robots: tuple[str, ...]
    problem: Problem
    values: Values
    first_poses: Mapping[str, int]
    origins: Mapping[str, Array]
    landmarks: tuple[tuple[LandmarkKey, ...], ...]
    chi_square: float = 0.0
    dof: int = 0
    base_nodes: Mapping[str, BaseNode] = field(default_factory=dict)

    @classmethod
    def of(cls, local: LocalMap) -> 'JointMap':
        """Return the map of a robot alone."""
        return cls(
            (local.robot,), local.problem, local.values, {local.robot: 0},
            {local.robot: local.values.poses[0]}, tuple((key,) for key in local.landmarks)
        ).solved()

    def solved(self) -> 'JointMap':
        """
        Return the map at the minimum of eq. (21), from its values on.

        Raises
        ------
        SingularError, ConvergenceError
            As `least_squares.solve` does.

        """
        solution = least_squares.solve(self.problem, self.values)
        problem = self.problem
        rows = 3 * len(problem.increments.u) + 2 * (
            len(problem.observations.z) + len(problem.rendezvous.z))
        return replace(
            self, values=solution.values, chi_square=solution.cost, dof=rows - solution.unknowns)

    def numbers(self) -> dict[LandmarkKey, int]:
        """Return the number of each landmark, by every name that it has."""
        return {key: number for number, keys in enumerate(self.landmarks) for key in keys}

    def information(self) -> Information:
        """Return what is known of all poses and landmarks."""
        return least_squares.information(self.problem, self.values)

    def in_frame_of(self, pose: int) -> 'JointMap':
        """Return the same map in the frame of one of its poses, by number, which is fixed."""
        back = between(self.values.poses[pose], np.zeros(3))
        return replace(
            self, problem=replace(self.problem, fixed_poses=(pose,)), values=Values(
                transform_poses(back, self.values.poses), transform(back, self.values.points)))

    def subset(self, met: Indices) -> RendezvousInformation:
        """
        Return what is known of poses that met, in the frame of the one in the middle.

        Parameters
        ----------
        met : (k,) array, their numbers in the order of the subset; the start is appended to them

        """
        start, = self.problem.fixed_poses
        there = self.in_frame_of(int(met[len(met) // 2]))
        return subset(
            there.values.poses, met, start, self.values.poses[start], there.information())

    def with_one_of(self, pairs: Sequence[LandmarkPair], near: 'JointMap') -> 'JointMap':
        """
        Return the minimum in which the landmarks of each pair are one.

        Parameters
        ----------
        pairs : their numbers
        near : the same map with fewer or more pairs joined, to start from

        """
        label = np.arange(len(self.landmarks))
        for one, other in pairs:
            label[label == label[other]] = label[one]
        _, of = np.unique(label, return_inverse=True)
        members = np.bincount(of)
        numbers = near.numbers()
        start = near.values.points[[numbers[keys[0]] for keys in self.landmarks]]
        points = np.column_stack([np.bincount(of, start[:, k]) / members for k in (0, 1)])
        landmarks = tuple(
            tuple(key for number in np.flatnonzero(of == k) for key in self.landmarks[number])
            for k in range(len(members)))
        observations = self.problem.observations
        problem = replace(
            self.problem, observations=replace(observations, landmark=of[observations.landmark]))
        return replace(
            self, problem=problem, values=Values(near.values.poses, points),
            landmarks=landmarks).solved()

    def with_base_nodes(self) -> 'JointMap':
        """Return the map with the base nodes of all robots but the first."""
        known = self.information()
        return replace(self, base_nodes={
            robot: self._base_node(robot, known) for robot in self.robots[1:]})

    def _base_node(self, robot: str, known: Information) -> BaseNode:
        first = self.first_poses[robot]
        pose, back = self.values.poses[first], between(self.origins[robot], np.zeros(3))
        G = models.Phi(rotation(pose[2]) @ back[:2])
        return BaseNode(compose(pose, back), G @ known.joint(poses=[first]) @ G.T)


def subset(
    poses: Array, met: Indices, start: int, origin: Array, known: Information
) -> RendezvousInformation:
    """
    Return what is known of poses that met, as `JointMap.subset` does.

    Parameters
    ----------
    poses : (n, 3) array, all poses of the map, in the frame of the middle one of those that met
    met : (k,) array, numbers of those
    start : number of the pose that is fixed in the map
    origin : (3,) array, that pose in the frame of the map
    known : of all poses and landmarks, in the frame that `poses` are in

    """
    middle, rows = len(met) // 2, met if start in met else np.append(met, start)
    P = known.joint(poses=np.delete(rows, middle).tolist())
    return RendezvousInformation(
        poses[rows], middle, rows.tolist().index(start), origin, square_root_information(P))


def placed(p: JointMap, q: JointMap, b: Array) -> JointMap:
    """
    Return two maps as one, before it is solved for.

    Parameters
    ----------
    p, q : the maps; landmarks that have a name in common are one
    b : (3,) array, pose of the frame of q in that of p

    """
    known = p.numbers()
    fresh = [known.keys().isdisjoint(keys) for keys in q.landmarks]
    landmarks = (*p.landmarks, *(keys for keys, is_new in zip(q.landmarks, fresh) if is_new))
    numbers = {key: number for number, keys in enumerate(landmarks) for key in keys}
    of_q = np.array([numbers[keys[0]] for keys in q.landmarks], np.intp)
    poses = len(p.values.poses)
    values = Values(
        np.vstack([p.values.poses, transform_poses(b, q.values.poses)]),
        np.vstack([p.values.points, transform(b, q.values.points[fresh])]))
    first = {robot: poses + number for robot, number in q.first_poses.items()}
    return JointMap(
        p.robots + q.robots, _both(p.problem, q.problem, poses, of_q), values,
        {**p.first_poses, **first}, {**p.origins, **q.origins}, landmarks)


def _both(p: Problem, q: Problem, poses: int, of_q: Indices) -> Problem:
    """Return two problems as one, the poses of q numbered after those of p."""
    ways, observations, robots = q.increments, q.observations, q.rendezvous
    return Problem(
        concatenated(p.increments, OdometryFactors(
            ways.begin + poses, ways.end + poses, ways.u, ways.Q)),
        concatenated(p.observations, LandmarkFactors(
            observations.pose + poses, of_q[observations.landmark], observations.z, observations.R)),
        concatenated(p.rendezvous, RendezvousFactors(
            robots.pose + poses, robots.seen + poses, robots.z, robots.R)),
        p.fixed_poses)
