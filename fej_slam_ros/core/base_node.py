# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The base node: where one map lies in another, from robots that saw each other.

Section IV-A of [Andersson]. Only the poses that met take part, with the square-root information
that their maps have of them; the rest of the maps is not needed, and need not be shared. Nothing
here depends on where the two frames are: the maps are taken in frames at the middle of the
meeting, where an error of the heading moves nothing far away.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
import math

import numpy as np
from scipy.linalg import cholesky, qr, solve_triangular
from scipy.stats import chi2

from fej_slam_ros.core import models
from fej_slam_ros.core.covariance import Indices
from fej_slam_ros.core.geometry import (
    Array, between, compose, Flags, pose_rotation, rotation, transform, wrap_all)

#: The sighted points spread at least this many of their standard deviations: where they spread
#: less, the robot's jitter passes for geometry.
MIN_SPREAD = 15.0
#: So many sightings make a start at first; a long meeting is bent by drift.
WINDOW = 8
#: A chi-square beyond this probability has sightings that are wrong.
CONSISTENT = 1.0 - 1e-6
#: Iteration ends when no coordinate moves further [m, rad].
TOLERANCE = 1e-10
MAX_ITERATIONS = 30
#: A diagonal entry of R_sqrt below this part of its largest is what rounding leaves of zero.
SINGULAR = 1e-13


class NotAlignedError(ArithmeticError):
    """Two maps cannot be aligned; the message says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Subset:
    """
    What one map says of the poses that met, A_m of eq. (25) of [Andersson].

    Attributes
    ----------
    poses : (k, 3) array, in the frame of the map [m, m, rad]
    R_sqrt : (r, 3 k) array; it costs |R_sqrt dx|^2 to move the poses by dx
    known : (k,) array of bool, which of them are known exactly; R_sqrt says nothing of these

    """

    poses: Array
    R_sqrt: Array
    known: Flags

    @classmethod
    def of(cls, poses: Array, P: Array, known: Flags) -> 'Subset':
        """Return the subset of poses (k, 3) whose joint covariance is P (3 k, 3 k)."""
        free = np.flatnonzero(np.repeat(~known, 3))
        # P = U U^T with U upper triangular, so that its inverse is R_sqrt.
        U = cholesky(P[np.ix_(free, free)][::-1, ::-1], lower=True)[::-1, ::-1]
        R_sqrt = np.zeros((len(free), 3 * len(poses)))
        R_sqrt[:, free] = solve_triangular(U, np.eye(len(free)))
        return cls(poses, R_sqrt, known)

    def seen_from(self, origin: Array) -> 'Subset':
        """Return the same in the frame of a pose (3,) that is known exactly."""
        poses = np.array([between(origin, pose) for pose in self.poses])
        back = np.kron(np.eye(len(poses)), pose_rotation(origin[2]))
        return replace(self, poses=poses, R_sqrt=self.R_sqrt @ back)


@dataclass(frozen=True, slots=True, eq=False)
class Sighted:
    """
    m sightings of robots of one map by robots of the other.

    Attributes
    ----------
    p, q : (m,) arrays, rows of the poses in the subsets of the two maps
    by_p : (m,) array of bool, whether p saw q; otherwise q saw p
    z : (m, 2) array, the seen robot in the base frame of the seer [m]
    R : (m, 2, 2) array, covariance of z [m^2]

    """

    p: Indices
    q: Indices
    by_p: Flags
    z: Array
    R: Array

    def part(self, which: slice) -> 'Sighted':
        """Return some of them."""
        return Sighted(
            self.p[which], self.q[which], self.by_p[which], self.z[which], self.R[which])


@dataclass(frozen=True, slots=True, eq=False)
class BaseNode:
    """Pose (3,) of the frame of map Q in that of map P, b_pq of [Andersson], and its P (3, 3)."""

    pose: Array
    P: Array

    def placed(self, at_p: Array, at_q: Array) -> 'BaseNode':
        """Return the same between maps in which poses at_p and at_q are the present frames."""
        back = between(at_q, np.zeros(3))
        G = pose_rotation(at_p[2]) @ models.Phi(rotation(self.pose[2]) @ back[:2])
        return BaseNode(compose(compose(at_p, self.pose), back), G @ self.P @ G.T)


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """
    The outcome of Algorithm 1.

    Attributes
    ----------
    base_node : where the map of q lies in that of p
    chi_square : how badly the sightings fit
    dof : degrees of freedom of that
    iterations : how many steps it took

    """

    base_node: BaseNode
    chi_square: float
    dof: int
    iterations: int


def align(p: Subset, q: Subset, sighted: Sighted) -> Aligned:
    """
    Return the base node that the sightings of a meeting give.

    Parameters
    ----------
    p, q : what the maps say of the poses that met
    sighted : the sightings, in the order of time

    Raises
    ------
    NotAlignedError
        There are too few sightings, they do not tell the heading, or they contradict the maps.

    """
    if len(sighted.z) < 2:
        raise NotAlignedError('not enough sightings: 1 of the 2 that are needed')
    at_p, at_q = _middle(p.poses, sighted.p), _middle(q.poses, sighted.q)
    p, q = p.seen_from(at_p), q.seen_from(at_q)
    starts = [*_starts(p, q, sighted)]
    if not starts:
        raise NotAlignedError(
            'cannot align: the sighted places lie within'
            f' {min(_spreads(p, q, sighted)):.1f} sigma, {MIN_SPREAD:g} are needed to tell the'
            ' heading')
    tried = [found for start in starts if (found := _solved(p, q, sighted, start)) is not None]
    if not tried:
        raise NotAlignedError('cannot align: the iteration did not converge')
    found = min(tried, key=lambda aligned: aligned.chi_square)
    limit = float(chi2.ppf(CONSISTENT, found.dof))
    if found.chi_square > limit:
        raise NotAlignedError(inconsistent(found.chi_square, limit, found.dof))
    return replace(found, base_node=found.base_node.placed(at_p, at_q))


def inconsistent(chi_square: float, limit: float, dof: int) -> str:
    """Return what to say of sightings that contradict the maps."""
    return (
        f'inconsistent (chi-square {chi_square:.1f}, at most {limit:.1f} for {dof} degrees of'
        ' freedom)')


def _solved(p: Subset, q: Subset, sighted: Sighted, start: Array) -> Aligned | None:
    """
    Return the base node by Algorithm 1, None where it does not converge.

    The maps stay linearised where they were solved for; only the rows of the sightings, eqs. (22)
    and (23), are linearised anew. It stops on the increment: the norm of b, on which the paper
    stops, tends to the noise that is left.

    """
    x_p, x_q, b = p.poses, q.poses, start
    k, n = 3 * len(x_p), 3 * (len(x_p) + len(x_q))
    free = np.append(np.repeat(~np.append(p.known, q.known), 3), [True, True, True])
    for iteration in range(1, MAX_ITERATIONS + 1):
        rows, right = _connector(x_p, x_q, b, sighted)
        moved = np.concatenate([_moved(p.poses, x_p), _moved(q.poses, x_q)])
        A = np.zeros((len(p.R_sqrt) + len(q.R_sqrt) + len(rows), n + 3))
        A[:len(p.R_sqrt), :k] = p.R_sqrt
        A[len(p.R_sqrt):-len(rows), k:n] = q.R_sqrt
        # Below are the connector's rows, eq. (25); above, maps pull back to where they were.
        right = np.concatenate([-A[:-len(rows), :n] @ moved, right])
        A[-len(rows):] = rows
        Q, R_sqrt = qr(A[:, free], mode='economic')
        if np.abs(np.diag(R_sqrt)).min() <= SINGULAR * np.abs(R_sqrt).max():
            return None
        dx = np.zeros(n + 3)
        dx[free] = solve_triangular(R_sqrt, Q.T @ right)
        x_p, x_q, b = _plus(x_p, dx[:k]), _plus(x_q, dx[k:n]), _plus(b[None], dx[n:])[0]
        if np.abs(dx).max() < TOLERANCE:
            # The base node comes last, so that its square-root information does.
            root = solve_triangular(R_sqrt[-3:, -3:], np.eye(3))
            return Aligned(
                BaseNode(b, root @ root.T), float(right @ right), 2 * len(sighted.z) - 3,
                iteration)
    return None


def _connector(x_p: Array, x_q: Array, b: Array, sighted: Sighted) -> tuple[Array, Array]:
    """Return the whitened rows C_m and residuals n_m of all sightings, eqs. (22) to (24)."""
    rows = np.zeros((len(sighted.z), 2, 3 * (len(x_p) + len(x_q)) + 3))
    n = np.zeros((len(sighted.z), 2))
    in_p = np.array([compose(b, x) for x in x_q])
    # How poses of q in the frame of p follow the base node, and themselves.
    by_b = np.array([models.Phi(y[:2] - b[:2]) for y in in_p])
    by_q = pose_rotation(b[2])
    for m, (i, j, z) in enumerate(zip(sighted.p, sighted.q, sighted.z)):
        seer, seen = (x_p[i], in_p[j]) if sighted.by_p[m] else (in_p[j], x_p[i])
        H = np.zeros((2, 6))
        H[:, :5] = models.H(seer[None], seen[None, :2])[0]
        of_p, of_q = (H[:, :3], H[:, 3:]) if sighted.by_p[m] else (H[:, 3:], H[:, :3])
        rows[m][:, 3 * i:3 * i + 3] = of_p
        rows[m][:, 3 * (len(x_p) + j):][:, :3] = of_q @ by_q
        rows[m][:, -3:] = of_q @ by_b[j]
        n[m] = z - models.h(seer[None], seen[None, :2])[0]
    white = np.linalg.inv(np.linalg.cholesky(sighted.R))
    return (white @ rows).reshape(-1, rows.shape[-1]), (white @ n[:, :, None]).ravel()


def _starts(p: Subset, q: Subset, sighted: Sighted) -> Iterator[Array]:
    """Yield base nodes to start from, of longer and longer windows in the middle of a meeting."""
    count, length = len(sighted.z), WINDOW
    while True:
        first = max(0, (count - length) // 2)
        window = sighted.part(slice(first, first + length))
        is_mutual = window.by_p.any() and not window.by_p.all()
        if is_mutual or min(_spreads(p, q, window)) >= MIN_SPREAD:
            yield closed_form(*_places(p, q, window))
        if length >= count:
            return
        length *= 2


def closed_form(of_p: Array, of_q: Array, weights: Array) -> Array:
    """
    Return the base node that brings places in map Q nearest to the same places in map P.

    Parameters
    ----------
    of_p, of_q : (m, 2) arrays, the places in the frames of the two maps [m]
    weights : (m,) array, one over the variance of each [1 / m^2]

    """
    middle_p, middle_q = (np.average(of, axis=0, weights=weights) for of in (of_p, of_q))
    a, b = of_q - middle_q, of_p - middle_p
    cos, sin = weights @ (a * b).sum(axis=1), weights @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    phi = math.atan2(sin, cos)
    return np.array([*(middle_p - rotation(phi) @ middle_q), phi])


def _places(p: Subset, q: Subset, sighted: Sighted) -> tuple[Array, Array, Array]:
    """Return where each sighting has the seen robot in either map, and one over its variance."""
    of_p, of_q = p.poses[sighted.p, :2].copy(), q.poses[sighted.q, :2].copy()
    for m, (i, j, z) in enumerate(zip(sighted.p, sighted.q, sighted.z)):
        if sighted.by_p[m]:
            of_p[m] = transform(p.poses[i], z)
        else:
            of_q[m] = transform(q.poses[j], z)
    return of_p, of_q, 2.0 / np.trace(sighted.R, axis1=1, axis2=2)


def _spreads(p: Subset, q: Subset, sighted: Sighted) -> tuple[float, float]:
    """Return by how many standard deviations the sighted places spread, in either map."""
    of_p, of_q, weights = _places(p, q, sighted)
    spread_p, spread_q = (
        math.sqrt(np.mean(weights * np.square(
            of - np.average(of, axis=0, weights=weights)).sum(axis=1)))
        for of in (of_p, of_q))
    return spread_p, spread_q


def _middle(poses: Array, met: Indices) -> Array:
    middle: Array = poses[met[len(met) // 2]]
    return middle


def _moved(before: Array, after: Array) -> Array:
    dx = after - before
    dx[:, 2] = wrap_all(dx[:, 2])
    return dx.ravel()


def _plus(poses: Array, dx: Array) -> Array:
    after = poses + dx.reshape(-1, 3)
    after[:, 2] = wrap_all(after[:, 2])
    return after
