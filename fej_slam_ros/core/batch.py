# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Least squares over all poses of all robots and all landmarks: what the filters are judged against.

With the models of eqs. (2) and (7) of [Liu] it is the minimum over poses x = [p, phi] and
landmarks f, all in one frame, of the cost

    sum |u - x_begin^-1 o x_end|^2_Q + sum |z - C(phi)^T (f - p)|^2_R,    |r|^2_Q = r^T Q^-1 r,

with the residuals of headings wrapped. Poses and landmarks go by number, and which robot a pose
is of makes no difference. Pose 0, the first of the anchor, stays where it is.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array, vstack
from scipy.sparse.linalg import splu

from fej_slam_ros.core import models
from fej_slam_ros.core.covariance import Indices
from fej_slam_ros.core.geometry import Array, wrap_all

#: Iteration ends when no coordinate moves further [m, rad]: the next step would be far smaller.
TOLERANCE = 1e-9
MAX_ITERATIONS = 100


class BatchError(ArithmeticError):
    """No minimum was found: too little was measured, or the start was too far away."""


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
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


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """
    What m sightings say.

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


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """All that was measured."""

    increments: Increments
    sightings: Sightings


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """Poses (n, 3) [m, m, rad] and landmarks (l, 2) [m], both by number, in one frame."""

    poses: Array
    points: Array


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

    """

    values: Values
    cost: float
    unknowns: int
    iterations: int


def solve(problem: Problem, start: Values) -> Solution:
    """
    Return the minimum that Gauss-Newton finds from a start.

    It need not be the lowest: far from the truth it depends on the start.

    Raises
    ------
    BatchError
        If the normal matrix is singular or the iteration does not converge.

    """
    x = start
    for iteration in range(1, MAX_ITERATIONS + 1):
        A, r = _linearized(problem, x)
        dx = _least_squares(A, r)
        x = _moved(x, dx)
        if np.abs(dx).max() < TOLERANCE:
            _, r = _linearized(problem, x)
            return Solution(x, float(r @ r), len(dx), iteration)
    raise BatchError(f'least squares did not converge in {MAX_ITERATIONS} iterations')


def _linearized(problem: Problem, x: Values) -> tuple[csr_array, Array]:
    """Return A and r of the cost |r - A dx|^2 near x."""
    width = x.poses.size + x.points.size
    A_u, r_u = _increment_rows(problem.increments, x, width)
    A_z, r_z = _sighting_rows(problem.sightings, x, width)
    # Without the columns of pose 0 it stays where it is.
    return vstack([A_u, A_z], format='csr')[:, 3:], np.concatenate([r_u, r_z])


def _increment_rows(measured: Increments, x: Values, width: int) -> tuple[csr_array, Array]:
    """Return the rows of odometry: the end is sighted as a landmark is, and its heading."""
    begin, end = x.poses[measured.begin], x.poses[measured.end]
    r = measured.u - np.column_stack([models.h(begin, end[:, :2]), end[:, 2] - begin[:, 2]])
    r[:, 2] = wrap_all(r[:, 2])
    H = np.zeros((len(r), 3, 6))
    H[:, :2, :5] = models.H(begin, end[:, :2])
    H[:, 2, 2], H[:, 2, 5] = -1.0, 1.0
    columns = np.hstack([_pose_columns(measured.begin), _pose_columns(measured.end)])
    return _whitened(H, r, measured.Q, columns, width)


def _sighting_rows(measured: Sightings, x: Values, width: int) -> tuple[csr_array, Array]:
    """Return the rows of the sightings, eqs. (7), (10) and (11)."""
    poses, points = x.poses[measured.pose], x.points[measured.landmark]
    H, r = models.H(poses, points), measured.z - models.h(poses, points)
    point_columns = x.poses.size + 2 * measured.landmark[:, None] + np.arange(2)
    columns = np.hstack([_pose_columns(measured.pose), point_columns])
    return _whitened(H, r, measured.R, columns, width)


def _pose_columns(poses: Indices) -> Indices:
    return 3 * poses[:, None] + np.arange(3)


def _whitened(
    H: Array, r: Array, covariance: Array, columns: Indices, width: int
) -> tuple[csr_array, Array]:
    """
    Return L^-1 H, put to its columns, and L^-1 r, where L L^T is the covariance.

    Parameters
    ----------
    H : (k, d, c) array, Jacobians of k measurements of d coordinates
    r : (k, d) array, their residuals
    covariance : (d, d) or (k, d, d) array
    columns : (k, c) array, where the columns of each Jacobian belong
    width : number of columns of the result

    """
    k, d, c = H.shape
    white = np.linalg.solve(np.linalg.cholesky(covariance), np.dstack([H, r]))
    indices, starts = np.repeat(columns, d, axis=0), np.arange(0, k * d * c + 1, c)
    A = csr_array((white[:, :, :c].ravel(), indices.ravel(), starts), shape=(k * d, width))
    return A, white[:, :, c].ravel()


def _least_squares(A: csr_array, r: Array) -> Array:
    """Return the dx with A^T A dx = A^T r."""
    try:
        factors = splu(
            (A.T @ A).tocsc(), permc_spec='MMD_AT_PLUS_A', diag_pivot_thresh=0.0,
            options={'SymmetricMode': True})
    except RuntimeError:
        raise BatchError('the measurements do not determine all poses and landmarks') from None
    dx: Array = factors.solve(A.T @ r)
    return dx


def _moved(x: Values, dx: Array) -> Values:
    """Return x moved by dx: first the poses but pose 0, then the points."""
    of_poses, of_points = np.split(dx, [x.poses.size - 3])
    poses = x.poses.copy()
    poses[1:] += of_poses.reshape(-1, 3)
    poses[:, 2] = wrap_all(poses[:, 2])
    return Values(poses, x.points + of_points.reshape(-1, 2))
