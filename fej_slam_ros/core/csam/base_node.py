# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
The base node: where one map lies in another, from robots that saw each other.

Section IV-A of [Andersson]. Only the poses that met take part, with the square-root information
that their maps have of them; the rest of the maps is not needed, and need not be shared. Each map
is told in the frame of the pose in the middle of the meeting. There its poses are certain but for
the drift within the meeting, so that its linearisation holds however far the robot has come; the
start of the map is one more pose, as uncertain as the way back to it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
from scipy.linalg import block_diag, cholesky, qr, solve_triangular
from scipy.stats import chi2

from fej_slam_ros.core import models
from fej_slam_ros.core.chi_square import squared_distances
from fej_slam_ros.core.geometry import (
    Array, between, compose, corrected, Flags, Indices, pose_rotation, rigid_fit, rotation,
    transform, transform_poses, wrap_all)
from fej_slam_ros.core.smoothing.least_squares import whitener

#: The sighted points spread at least this many of their standard deviations: where they spread
#: less, the robot's jitter passes for geometry.
MIN_SPREAD = 15.0
#: So many observations make a start at first; a long meeting is bent by drift.
WINDOW = 8
#: Iteration ends when no coordinate moves further [m, rad].
TOLERANCE = 1e-8
MAX_ITERATIONS = 30
#: A diagonal entry of R_sqrt below this part of its largest is what rounding leaves of zero.
SINGULAR = 1e-13
#: It is not known by how much chi-square falls without each observation.
NO_GAINS: Array = np.zeros(0)


class NotAlignedError(ArithmeticError):
    """Two maps cannot be aligned; the message says why."""


class InconsistentError(NotAlignedError):
    """Observations contradict the maps; gains (m,) tell how much better it is without each."""

    def __init__(self, message: str, gains: Array) -> None:
        super().__init__(message)
        self.gains = gains


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousInformation:
    """
    What one map says of the poses that met, A_m of eq. (25) of [Andersson].

    Attributes
    ----------
    poses : (k, 3) array, in the frame of one of them [m, m, rad]
    middle : row of that one
    start : row of the pose that is fixed in the map
    origin : (3,) array, that pose in the frame of the map
    R_sqrt : (3 k - 3, 3 k - 3) array, upper triangular; it costs |R_sqrt dx|^2 to move all poses
        but the middle one by dx

    """

    poses: Array
    middle: int
    start: int
    origin: Array
    R_sqrt: Array

    @property
    def free(self) -> Indices:
        """Return the coordinates that R_sqrt is of."""
        return np.flatnonzero(np.repeat(np.arange(len(self.poses)) != self.middle, 3))


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousObservations:
    """
    m observations of robots of one map by robots of the other.

    Attributes
    ----------
    p, q : (m,) arrays, which poses of the two maps met, by number or by row of a subset
    by_p : (m,) array of bool, whether p saw q; otherwise q saw p
    z : (m, 2) array, the seen robot in the base frame of the seer [m]
    R : (m, 2, 2) array, covariance of z [m^2]

    """

    p: Indices
    q: Indices
    by_p: Flags
    z: Array
    R: Array

    def part(self, which: slice) -> 'RendezvousObservations':
        """Return some of them."""
        return RendezvousObservations(
            self.p[which], self.q[which], self.by_p[which], self.z[which], self.R[which])


@dataclass(frozen=True, slots=True, eq=False)
class BaseNode:
    """Pose (3,) of the frame of map Q in that of map P, b_pq of [Andersson], and its P (3, 3)."""

    pose: Array
    P: Array


@dataclass(frozen=True, slots=True, eq=False)
class Aligned:
    """
    The outcome of Algorithm 1.

    Attributes
    ----------
    base_node : where the map of q lies in that of p
    chi_square : how badly the observations fit the maps
    dof : degrees of freedom of that
    iterations : how many steps it took
    gains : (m,) array, by how much chi-square falls without each observation

    """

    base_node: BaseNode
    chi_square: float
    dof: int
    iterations: int
    gains: Array


def square_root_information(P: Array) -> Array:
    """Return the upper triangular R_sqrt (n, n) with R_sqrt^T R_sqrt = P^-1."""
    # P = U U^T with U upper triangular.
    U = cholesky(P[::-1, ::-1], lower=True)[::-1, ::-1]
    R_sqrt: Array = solve_triangular(U, np.eye(len(P)))
    return R_sqrt


def align(p: RendezvousInformation, q: RendezvousInformation, sighted: RendezvousObservations, probability: float) -> Aligned:
    """
    Return the base node that the observations of a meeting give.

    Parameters
    ----------
    p, q : what the maps say of the poses that met
    sighted : the observations, in the order of time
    probability : right observations are accepted with this chi-square probability

    Raises
    ------
    NotAlignedError
        There are too few observations, they do not tell the heading, or they contradict the maps.

    """
    if len(sighted.z) < 2:
        raise NotAlignedError('not enough observations: 1 of the 2 that are needed')
    starts = [*_starts(p, q, sighted)]
    if not starts:
        raise NotAlignedError(
            'cannot align: the sighted places lie within'
            f' {min(_spreads(p, q, sighted)):.1f} sigma, {MIN_SPREAD:g} are needed to tell the'
            ' heading')
    # From all of them the minimum is the same, where there is one.
    found = next(filter(None, (_solved(p, q, sighted, start) for start in starts)), None)
    if found is None:
        raise NotAlignedError('cannot align: the iteration did not converge')
    require_consistent(found.chi_square, found.dof, probability, found.gains)
    return found


def require_consistent(
    chi_square: float, dof: int, probability: float, gains: Array = NO_GAINS
) -> None:
    """
    Refuse observations that contradict the maps.

    Raises
    ------
    InconsistentError
        Chi-square is beyond the probability. The error keeps by how much it falls without each
        observation (m,), where that is known.

    """
    limit = chi2.ppf(probability, dof)
    if chi_square > limit:
        raise InconsistentError(
            f'inconsistent (chi-square {chi_square:.1f} with {dof} degrees of freedom, at most'
            f' {limit:.1f})', gains)


def _solved(p: RendezvousInformation, q: RendezvousInformation, sighted: RendezvousObservations, start: Array) -> Aligned | None:
    """
    Return the base node by Algorithm 1, None where it does not converge.

    The maps stay linearised where they were solved for; only the rows of the observations, eqs. (22)
    and (23), are linearised anew. It stops on the increment: the norm of b, on which the paper
    stops, tends to the noise that is left.

    """
    x_p, x_q, b = p.poses, q.poses, start
    k, n = x_p.size, x_p.size + x_q.size
    free = np.concatenate([p.free, k + q.free, [n, n + 1, n + 2]])
    maps = block_diag(p.R_sqrt, q.R_sqrt, np.empty((0, 3)))
    for iteration in range(1, MAX_ITERATIONS + 1):
        connector, n_m = _connector(x_p, x_q, b, sighted)
        moved = np.concatenate([_moved(p.poses, x_p), _moved(q.poses, x_q), np.zeros(3)])
        # Eq. (25); the maps pull back to where they were.
        A = np.vstack([maps, connector[:, free]])
        Q, R_sqrt = qr(A, mode='economic')
        diagonal = np.abs(np.diag(R_sqrt))
        if diagonal.min() <= SINGULAR * diagonal.max():
            return None
        right = np.concatenate([-maps @ moved[free], n_m])
        dx = np.zeros(n + 3)
        dx[free] = solve_triangular(R_sqrt, Q.T @ right)
        x_p, x_q = corrected(x_p, dx[:k]), corrected(x_q, dx[k:n])
        b = corrected(b[None], dx[n:])[0]
        if np.abs(dx).max() < TOLERANCE:
            pose, G = _between_maps(p, q, x_p, x_q, b)
            root = solve_triangular(R_sqrt, G[:, free].T, trans='T')
            return Aligned(
                BaseNode(pose, root.T @ root), float(right @ right), 2 * len(sighted.z) - 3,
                iteration, _gains(Q[-len(n_m):], n_m))
    return None


def _gains(Q: Array, n_m: Array) -> Array:
    """
    Return by how much chi-square falls without each observation (m,).

    That is n^T (I - Q Q^T)^-1 n of the rows of A = Q R_sqrt and the residuals of an observation: what
    is left of a wrong one is little where the maps give way to it.

    """
    rows, n = Q.reshape(len(n_m) // 2, 2, -1), n_m.reshape(-1, 2)
    S = np.eye(2) - rows @ rows.transpose(0, 2, 1)
    return squared_distances(n, S)


def _between_maps(
    p: RendezvousInformation, q: RendezvousInformation, x_p: Array, x_q: Array, b: Array
) -> tuple[Array, Array]:
    """Return the base node between the maps from that of their middles, and its Jacobian."""
    start_p, start_q = x_p[p.start], x_q[q.start]
    at_q = compose(b, start_q)
    way, back = between(start_p, at_q), between(q.origin, np.zeros(3))
    of_way = pose_rotation(p.origin[2]) @ models.Phi(rotation(way[2]) @ back[:2])
    H = of_way @ models.H_pose(start_p[None], at_q[None])[0]
    G = np.zeros((3, x_p.size + x_q.size + 3))
    G[:, 3 * p.start:][:, :3] = H[:, :3]
    G[:, x_p.size + 3 * q.start:][:, :3] = H[:, 3:] @ pose_rotation(b[2])
    G[:, -3:] = H[:, 3:] @ models.Phi(at_q[:2] - b[:2])
    return compose(compose(p.origin, way), back), G


def _connector(x_p: Array, x_q: Array, b: Array, sighted: RendezvousObservations) -> tuple[Array, Array]:
    """Return the whitened rows C_m and residuals n_m of all observations, eqs. (22) to (24)."""
    in_p = transform_poses(b, x_q)
    of_p, of_q, by_p = x_p[sighted.p], in_p[sighted.q], sighted.by_p[:, None]
    observer, seen = np.where(by_p, of_p, of_q), np.where(by_p, of_q, of_p)
    H = models.H_pose(observer, seen)[:, :2]
    H_p = np.where(by_p[:, None], H[:, :, :3], H[:, :, 3:])
    H_q = np.where(by_p[:, None], H[:, :, 3:], H[:, :, :3])
    # How poses of q in the frame of p follow themselves, and the base node.
    by_q, by_b = pose_rotation(b[2]), np.array([models.Phi(y[:2] - b[:2]) for y in of_q])
    C = np.zeros((len(H), 2, 3 * (len(x_p) + len(x_q)) + 3))
    C[:, :, -3:] = H_q @ by_b
    for m, (i, j) in enumerate(zip(sighted.p, sighted.q)):
        C[m, :, 3 * i:][:, :3] = H_p[m]
        C[m, :, 3 * (len(x_p) + j):][:, :3] = H_q[m] @ by_q
    n = sighted.z - models.h(observer, seen[:, :2])
    white = whitener(sighted.R)
    return (white @ C).reshape(-1, C.shape[-1]), (white @ n[:, :, None]).ravel()


def _starts(p: RendezvousInformation, q: RendezvousInformation, sighted: RendezvousObservations) -> Iterator[Array]:
    """Yield base nodes to start from, of longer and longer windows in the middle of a meeting."""
    count, length = len(sighted.z), WINDOW
    while True:
        window = sighted.part(central(count, length))
        is_mutual = window.by_p.any() and not window.by_p.all()
        if is_mutual or min(_spreads(p, q, window)) >= MIN_SPREAD:
            yield rigid_fit(*_places(p, q, window))
        if length >= count:
            return
        length *= 2


def central(count: int, length: int) -> slice:
    """Return so many in the middle of a count, or all."""
    first = max(0, (count - length) // 2)
    return slice(first, first + length)


def _places(p: RendezvousInformation, q: RendezvousInformation, sighted: RendezvousObservations) -> tuple[Array, Array, Array]:
    """Return where each observation has the seen robot in q and in p, and one over its variance."""
    of_p, of_q = p.poses[sighted.p, :2].copy(), q.poses[sighted.q, :2].copy()
    for m, (i, j, z) in enumerate(zip(sighted.p, sighted.q, sighted.z)):
        if sighted.by_p[m]:
            of_p[m] = transform(p.poses[i], z)
        else:
            of_q[m] = transform(q.poses[j], z)
    return of_q, of_p, 2.0 / np.trace(sighted.R, axis1=1, axis2=2)


def _spreads(p: RendezvousInformation, q: RendezvousInformation, sighted: RendezvousObservations) -> tuple[float, float]:
    """Return by how many standard deviations the sighted places spread, in either map."""
    of_q, of_p, weights = _places(p, q, sighted)
    spread_p, spread_q = (
        math.sqrt(np.mean(weights * np.square(
            of - np.average(of, axis=0, weights=weights)).sum(axis=1)))
        for of in (of_p, of_q))
    return spread_p, spread_q


def _moved(before: Array, after: Array) -> Array:
    dx = after - before
    dx[:, 2] = wrap_all(dx[:, 2])
    return dx.ravel()
