# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Least squares over all poses of all robots and all landmarks, in one frame.

It is the minimum over poses x = [p, phi] and landmarks f of the cost

    sum |u - x_begin^-1 o x_end|^2_Q + sum |z - C(phi)^T (f - p)|^2_R
    + sum |z - C(phi)^T (p_seen - p)|^2_R,    |r|^2_Q = r^T Q^-1 r,

with the residuals of headings wrapped. The first two sums are eq. (1) of [Andersson], and the
batch solution of eqs. (2) and (7) of [Liu]; with the third it is eq. (21) of [Andersson], whose
base node is the first pose of the other robot. Poses and landmarks go by number, and which robot a
pose is of makes no difference; numbers that follow the ways of the robots are fastest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np
from scipy.sparse import diags_array

from fej_slam_ros.core import models
from fej_slam_ros.core.geometry import Array, corrected, Indices, wrap_all
from fej_slam_ros.core.smoothing.marginals import Information
from fej_slam_ros.core.smoothing.normal_equations import Cholesky, NormalEquations

#: Iteration ends when no coordinate moves further [m, rad]; the next step would be far smaller.
TOLERANCE = 1e-9
MAX_ITERATIONS = 100

#: A step that raises the cost by no more than this part of it does so by rounding.
ROUNDING = 1e-12
#: Damping begins and ends with this part of the diagonal of A^T A.
LEAST_DAMPING = 1e-6


class ConvergenceError(ArithmeticError):
    """The iteration found no minimum: the start was too far away."""


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """Poses (n, 3) [m, m, rad] and landmarks (l, 2) [m], both by number, in one frame."""

    poses: Array
    points: Array


@dataclass(frozen=True, slots=True, eq=False)
class OdometryFactors:
    """
    What odometry says of K ways from pose to pose.

    Attributes
    ----------
    begin, end : (K,) arrays, numbers of the poses
    u : (K, 3) array, pose end in the frame of pose begin [m, m, rad]
    Q : (3, 3) or (K, 3, 3) array, covariance of u

    """

    begin: Indices
    end: Indices
    u: Array
    Q: Array

    def covariance(self) -> Array:
        """Return Q."""
        return self.Q

    def ties(self, poses: int) -> tuple[Indices, Indices]:
        """Return both ends as numbers of poses, after which come the landmarks."""
        return self.begin, self.end

    def linearized(self, x: Values) -> tuple[Array, Array]:
        """Return H (K, 3, 6) and r (K, 3)."""
        begin, end = x.poses[self.begin], x.poses[self.end]
        r = self.u - np.column_stack([models.h(begin, end[:, :2]), end[:, 2] - begin[:, 2]])
        r[:, 2] = wrap_all(r[:, 2])
        return models.H_pose(begin, end), r


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkFactors:
    """
    What m observations say.

    Attributes
    ----------
    pose, landmark : (m,) arrays, numbers of the pose that saw and of the landmark that was seen
    z : (m, 2) array, the landmark in the frame of the pose [m]
    R : (2, 2) or (m, 2, 2) array, covariance of z

    """

    pose: Indices
    landmark: Indices
    z: Array
    R: Array

    def covariance(self) -> Array:
        """Return R."""
        return self.R

    def ties(self, poses: int) -> tuple[Indices, Indices]:
        """Return both ends as numbers of poses, after which come the landmarks."""
        return self.pose, poses + self.landmark

    def linearized(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 5) and r (m, 2), eqs. (13), (16) and (17) of [Andersson]."""
        poses, points = x.poses[self.pose], x.points[self.landmark]
        return models.H(poses, points), self.z - models.h(poses, points)


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousFactors:
    """
    What m observations of robots by robots say.

    Attributes
    ----------
    pose, seen : (m,) arrays, numbers of the pose that saw and of the pose that was seen
    z : (m, 2) array, the position of the seen pose in the frame of the pose [m]
    R : (2, 2) or (m, 2, 2) array, covariance of z

    """

    pose: Indices
    seen: Indices
    z: Array
    R: Array

    def covariance(self) -> Array:
        """Return R."""
        return self.R

    def ties(self, poses: int) -> tuple[Indices, Indices]:
        """Return both ends as numbers of poses, after which come the landmarks."""
        return self.pose, self.seen

    def linearized(self, x: Values) -> tuple[Array, Array]:
        """Return H (m, 2, 6) and r (m, 2), eqs. (22) and (23) of [Andersson]."""
        poses, seen = x.poses[self.pose], x.poses[self.seen]
        return models.H_pose(poses, seen)[:, :2], self.z - models.h(poses, seen[:, :2])


Kind = TypeVar('Kind', OdometryFactors, LandmarkFactors, RendezvousFactors)


def concatenated(*parts: Kind) -> Kind:
    """Return measurements of one kind as one, in the same order."""
    begin, end, z, _ = zip(*(
        [getattr(part, field.name) for field in fields(part)] for part in parts))
    R = [_of_each(part.covariance(), len(values)) for part, values in zip(parts, z)]
    return type(parts[0])(*map(np.concatenate, (begin, end, z, R)))


def _of_each(covariance: Array, count: int) -> Array:
    """Return one covariance for each measurement, from those or from one that is that of all."""
    return np.broadcast_to(covariance, (count, *covariance.shape[-2:]))


#: Nobody saw a robot.
NO_RENDEZVOUS = RendezvousFactors(
    np.empty(0, np.intp), np.empty(0, np.intp), np.empty((0, 2)), np.eye(2))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """
    All that was measured.

    Attributes
    ----------
    increments, observations, rendezvous : the measurements
    fixed_poses, fixed_landmarks : numbers of those that stay where they start; each robot that is
        not tied to others needs one such pose

    """

    increments: OdometryFactors
    observations: LandmarkFactors
    rendezvous: RendezvousFactors = NO_RENDEZVOUS
    fixed_poses: Sequence[int] = (0,)
    fixed_landmarks: Sequence[int] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """
    A minimum of the cost.

    Attributes
    ----------
    values : where it is
    cost : how low it is; chi-square, where Q and R are the covariances of the measurements
    unknowns : how many coordinates were solved for
    iterations : how many steps it took
    rejected : how many of them would have raised the cost and were damped instead

    """

    values: Values
    cost: float
    unknowns: int
    iterations: int
    rejected: int


def solve(problem: Problem, start: Values, tolerance: float = TOLERANCE) -> Solution:
    """
    Return the minimum that Gauss-Newton finds from a start.

    A step that would raise the cost is not taken; damping, by Nielsen's rule, begins there and
    ends when steps are good again. The minimum need not be the lowest: far from the truth it
    depends on the start.

    Parameters
    ----------
    problem : what was measured; there is something
    start : from where to begin; what is fixed stays there
    tolerance : the end is where no coordinate moves further [m, rad]

    Raises
    ------
    SingularError
        The measurements do not determine all poses and landmarks.
    ConvergenceError
        The start was too far away.

    """
    system = _System(problem, start)
    unknowns = len(system.equations.coordinates)
    near = system.linearized(start)
    damping = _Damping()
    for iteration in range(1, MAX_ITERATIONS + 1):
        dx, promised = system.step(near, damping.value)
        there = system.linearized(_moved(near.values, dx))
        if damping.value == 0.0 and np.abs(dx).max(initial=0.0) < tolerance:
            return Solution(
                there.values, there.cost, unknowns, iteration, damping.rejected)
        if damping.accepts(near.cost, there.cost, promised):
            near = there
    raise ConvergenceError(f'least squares did not converge in {MAX_ITERATIONS} iterations')


def information(problem: Problem, values: Values) -> Information:
    """
    Return the information matrix and the covariances, linearised at some values.

    Raises
    ------
    SingularError
        The measurements do not determine all poses and landmarks.

    """
    system = _System(problem, values)
    A = system.linearized(values).A
    return Information(
        system.equations.matrix(A), system.equations.coordinates,
        len(values.poses), len(values.points))


@dataclass(frozen=True, slots=True, eq=False)
class _Linearized:
    """The cost sum |b - A dx|^2 near values, by kinds of measurements: A (k, d, c), b (k, d)."""

    values: Values
    A: list[Array]
    b: list[Array]
    cost: float


class _System:
    """What stays the same from step to step."""

    def __init__(self, problem: Problem, start: Values) -> None:
        kinds = problem.increments, problem.observations, problem.rendezvous
        poses, points = len(start.poses), len(start.points)
        self._measured = [kind for kind in kinds if len(kind.ties(poses)[0]) > 0]
        free = np.ones(poses + points, bool)
        free[list(problem.fixed_poses)] = False
        free[poses + np.array(problem.fixed_landmarks, np.intp)] = False
        self.equations = NormalEquations(
            np.repeat([3, 2], [poses, points]), np.flatnonzero(free),
            [kind.ties(poses) for kind in self._measured])
        self._whiteners = [whitener(kind.covariance()) for kind in self._measured]

    def linearized(self, x: Values) -> _Linearized:
        """Return A and b of eq. (2) of [Andersson], whitened."""
        H, r = zip(*(kind.linearized(x) for kind in self._measured))
        A = [white @ of_kind for white, of_kind in zip(self._whiteners, H)]
        b = [(white @ of_kind[:, :, None])[:, :, 0] for white, of_kind in zip(self._whiteners, r)]
        return _Linearized(x, A, b, float(sum(np.vdot(of_kind, of_kind) for of_kind in b)))

    def step(self, near: _Linearized, damping: float) -> tuple[Array, float]:
        """Return the step dx by coordinate, and by how much it lowers the linearised cost."""
        N, g = self.equations.matrix(near.A), self.equations.right_side(near.A, near.b)
        added = damping * N.diagonal()
        if damping > 0.0:
            N = N + diags_array(added)
        of_unknowns = Cholesky(N).solve(g)
        dx = np.zeros(near.values.poses.size + near.values.points.size)
        dx[self.equations.coordinates] = of_unknowns
        return dx, float(of_unknowns @ (g + added * of_unknowns))


class _Damping:
    """
    Nielsen's rule, but that it is nothing until a step fails and ends when it is small.

    Attributes
    ----------
    value : of the diagonal of A^T A, as much is added to it
    rejected : how many steps failed

    """

    def __init__(self) -> None:
        self.value, self.rejected = 0.0, 0
        self._growth = 2.0

    def accepts(self, before: float, after: float, promised: float) -> bool:
        """Return whether a step lowered the cost, and damp the next one accordingly."""
        if after > before * (1.0 + ROUNDING):
            self.rejected += 1
            self.value = max(self._growth * self.value, LEAST_DAMPING)
            self._growth *= 2.0
            return False
        if self.value > 0.0:
            gain = (before - after) / promised
            self.value *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3)
            self._growth = 2.0
            # Rounding hides the gain of the last steps.
            if self.value < LEAST_DAMPING or promised < ROUNDING * before:
                self.value = 0.0
        return True


def whitener(covariance: Array) -> Array:
    """Return L^-1 of the covariance L L^T, which is one (d, d) or each of some (k, d, d)."""
    return np.linalg.solve(np.linalg.cholesky(covariance), np.eye(covariance.shape[-1]))


def _moved(x: Values, dx: Array) -> Values:
    """Return x moved by dx."""
    of_poses, of_points = np.split(dx, [x.poses.size])
    return Values(corrected(x.poses, of_poses), x.points + of_points.reshape(-1, 2))
