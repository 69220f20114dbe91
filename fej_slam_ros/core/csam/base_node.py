# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Algorithm 1 of [Andersson]: pose of one map in another from robot-to-robot observations.

Section IV-A. Only the rendezvous poses take part, with the square-root information that their maps
have of them. Each map is expressed in the frame of its middle rendezvous pose, where the poses are
certain up to the drift within the rendezvous, so that the linearisation holds however far the
robot has driven. Pose 0 of the map is one more pose, as uncertain as the trajectory back to it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
import math

import numpy as np
from scipy.linalg import block_diag, cholesky, LinAlgError, qr, solve_triangular

from fej_slam_ros.core import models
from fej_slam_ros.core.chi_square import distances_where_tested
from fej_slam_ros.core.gauss_newton import (
    ConvergenceError, gauss_newton, NoMinimumError, SingularError)
from fej_slam_ros.core.geometry import (
    Array, between, compose, Flags, Indices, inverse, pose_difference, pose_rotation, poses_plus,
    rigid_fit, rotation, transform, transform_poses)
from fej_slam_ros.core.join_failure import JoinFailure
from fej_slam_ros.core.smoothing.factors import whitener

#: Smallest spread of the observed positions, in standard deviations: below it noise passes for
#: geometry and the heading is overconfident.
MIN_SPREAD_SIGMAS = 15.0
#: Observations in the first window for a start; drift distorts a longer window.
FIRST_WINDOW = 8
#: Largest increment of a coordinate at the end [m, rad].
ALIGNMENT_TOLERANCE = 1e-8
#: Maximum number of steps; ten are enough from a good start.
MAX_ALIGNMENT_ITERATIONS = 30
#: Minimum number of observations that determine a base node.
MIN_ALIGNMENT_OBSERVATIONS = 2
#: Smallest ratio of diagonal entries of R_sqrt; below it an entry is a rounded zero.
MIN_DIAGONAL_RATIO = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousInformation:
    """Information of one map about its rendezvous poses, A_m of eq. (25) of [Andersson]."""

    poses: Array  #: (k, 3) array, in the frame of the middle one [m, m, rad]
    middle: int  #: row of that pose
    start: int  #: row of the pose that is fixed in the map
    origin: Array  #: (3,) array, that pose in the frame of the map
    #: (3 k - 3, 3 k - 3) array, upper triangular; moving all poses but the middle one by dx costs
    #: |R_sqrt dx|^2
    R_sqrt: Array

    @property
    def free(self) -> Indices:
        """Return the coordinates (3 k - 3,) of the columns of R_sqrt."""
        return np.flatnonzero(np.repeat(np.arange(len(self.poses)) != self.middle, 3))

    def in_map(self, row: int) -> Array:
        """Return a pose (3,) in the frame of the map."""
        return compose(self.origin, between(self.poses[self.start], self.poses[row]))


@dataclass(frozen=True, slots=True, eq=False)
class RendezvousObservations:
    """m observations between a robot of map P and a robot of map Q."""

    #: p, q: (m,) arrays, rows of the poses in the `RendezvousInformation` of the two maps
    p: Indices
    q: Indices
    by_p: Flags  #: (m,) array of bool, True if the robot of P is the observer
    z: Array  #: (m, 2) array, position of the observed robot in the base frame of the observer [m]
    R: Array  #: (m, 2, 2) array, covariance of z [m^2]


@dataclass(frozen=True, slots=True, eq=False)
class BaseNode:
    """Pose (3,) of the frame of map Q in that of map P, b_pq of [Andersson], and its P (3, 3)."""

    pose: Array
    P: Array


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Result of Algorithm 1."""

    base_node: BaseNode  #: pose of map Q in map P
    #: chi_square, dof: weighted squared residual at the minimum, and its degrees of freedom
    chi_square: float
    dof: int
    d2: Array  #: (m,) array, decrease of chi-square without each observation


def square_root_information(P: Array) -> Array:
    """
    Return the upper triangular R_sqrt (n, n) with R_sqrt^T R_sqrt = P^-1.

    Raises
    ------
    SingularError
        If P is not positive definite within rounding.

    """
    if not len(P):
        # solve_triangular of scipy 1.11 rejects a matrix without rows.
        return P
    # P = U U^T with U upper triangular.
    try:
        U = cholesky(P[::-1, ::-1], lower=True)[::-1, ::-1]
    except LinAlgError:
        raise SingularError('the covariance of the poses of a rendezvous is singular') from None
    R_sqrt: Array = solve_triangular(U, np.eye(len(P)))
    return R_sqrt


def align(
    p: RendezvousInformation, q: RendezvousInformation, observations: RendezvousObservations
) -> Alignment | JoinFailure:
    """
    Return the base node of two maps from observations in the order of time.

    Raises
    ------
    ConvergenceError
        If there is no minimum, as beside an observation that is far off, see `farthest`.

    """
    if len(observations.z) < MIN_ALIGNMENT_OBSERVATIONS:
        return JoinFailure(
            f'not enough observations: 1 of the {MIN_ALIGNMENT_OBSERVATIONS} that are needed')
    algorithm = _Algorithm1(p, q, observations)
    starts = [*algorithm.starts()]
    if not starts:
        return JoinFailure(
            f'cannot align: the observed positions lie within {algorithm.spread():.1f} sigma,'
            f' {MIN_SPREAD_SIGMAS:g} are needed to determine the heading')
    # All starts lead to one minimum, if there is one.
    for start in starts:
        try:
            return algorithm.solve(start)
        except NoMinimumError:  # noqa: PERF203
            continue
    raise ConvergenceError('the iteration did not converge')


def farthest(
    p: RendezvousInformation, q: RendezvousInformation, observations: RendezvousObservations
) -> tuple[int, float]:
    """Return the observation farthest from a rigid fit of all, and its squared distance."""
    return _Algorithm1(p, q, observations).farthest()


def central(count: int, length: int) -> slice:
    """Return the middle `length` of `count` items, or all of them."""
    first = max(0, (count - length) // 2)
    return slice(first, first + length)


#: Rendezvous poses of P (k, 3) and of Q (l, 3), and the base node (3,) between their frames.
_Nodes = tuple[Array, Array, Array]


@dataclass(frozen=True, slots=True, eq=False)
class _LinearizedAlignment:
    """The rows A' = Q R_sqrt and b of eq. (25) in the free coordinates."""

    Q: Array
    R_sqrt: Array
    b: Array

    @property
    def cost(self) -> float:
        """Return |b|^2."""
        return float(self.b @ self.b)


class _Algorithm1:
    """
    Algorithm 1, "Solving basenode", for `gauss_newton`.

    1. Optimise the local maps separately: done before, in R_sqrt of p and q.
    2. Add the rendezvous measurements to b by eq. (23) and to A' by eq. (22): `linearize`.
    3. Solve eq. (2) for A': `step`.
    4. Relinearise the nodes in the rows of 2, and repeat from 2: `retract`.

    The rows of the maps keep their linearisation; in b they pull the poses back to the maps'
    solution. The iteration stops on the increment: norm(b), on which the paper stops, tends to the
    norm of the noise.

    """

    def __init__(
        self, p: RendezvousInformation, q: RendezvousInformation,
        observations: RendezvousObservations,
    ) -> None:
        self._p, self._q, self._observations = p, q, observations
        k, n = p.poses.size, p.poses.size + q.poses.size
        self._sizes = [k, n]
        self._free = np.concatenate([p.free, k + q.free, [n, n + 1, n + 2]])
        self._maps = block_diag(p.R_sqrt, q.R_sqrt, np.empty((0, 3)))
        rows = [*zip(observations.p, observations.q, observations.by_p, observations.z)]
        # Observed positions in p and in q (m, 2), and one over their variance (m,).
        self._in_p = np.array([
            transform(p.poses[i], z) if by_p else p.poses[i, :2] for i, _, by_p, z in rows])
        self._in_q = np.array([
            q.poses[j, :2] if by_p else transform(q.poses[j], z) for _, j, by_p, z in rows])
        self._weights = 2.0 / np.trace(observations.R, axis1=1, axis2=2)

    def starts(self) -> Iterator[Array]:
        """Yield starts of the base node, (3,), by windows of doubling length around the middle."""
        count, length = len(self._weights), FIRST_WINDOW
        while True:
            window = central(count, length)
            by_p = self._observations.by_p[window]
            if (by_p.any() and not by_p.all()) or self.spread(window) >= MIN_SPREAD_SIGMAS:
                yield rigid_fit(self._in_q[window], self._in_p[window], self._weights[window])
            if length >= count:
                return
            length *= 2

    def farthest(self) -> tuple[int, float]:
        """Return the row of the observation farthest from a rigid fit, and d^2 [sigma^2]."""
        q_in_p = transform(rigid_fit(self._in_q, self._in_p, self._weights), self._in_q)
        d2 = self._weights * np.square(self._in_p - q_in_p).sum(axis=1)
        row = int(np.argmax(d2))
        return row, float(d2[row])

    def spread(self, window: slice = slice(None)) -> float:
        """Return the smaller spread of the observed positions in p and q [sigma]."""
        weights = self._weights[window]
        return min(
            math.sqrt(np.mean(weights * np.square(
                points - np.average(points, axis=0, weights=weights)).sum(axis=1)))
            for points in (self._in_p[window], self._in_q[window]))

    def solve(self, start: Array) -> Alignment:
        """Return the minimum from a start (3,) of the base node; errors of `gauss_newton`."""
        p, q, m = self._p, self._q, len(self._weights)
        x, at, _ = gauss_newton(self, (p.poses, q.poses, start), MAX_ALIGNMENT_ITERATIONS)
        pose, G = _base_node(p, q, *x)
        root = solve_triangular(at.R_sqrt, G[:, self._free].T, trans='T')
        # Of two observations both are needed, and neither can be tested.
        d2 = np.zeros(m) if m == MIN_ALIGNMENT_OBSERVATIONS else _decreases_of_chi_square(
            at.Q[-2 * m:].reshape(m, 2, -1), at.b[-2 * m:].reshape(m, 2))
        return Alignment(BaseNode(pose, root.T @ root), at.cost, 2 * m - 3, d2)

    def linearize(self, x: _Nodes) -> _LinearizedAlignment:
        """Return A' and b of eq. (25)."""
        C, n_m = _connector(*x, self._observations)
        dx_p, dx_q = pose_difference(x[0], self._p.poses), pose_difference(x[1], self._q.poses)
        dx = np.concatenate([dx_p.ravel(), dx_q.ravel(), np.zeros(3)])
        A = np.vstack([self._maps, C[:, self._free]])
        b = np.concatenate([-self._maps @ dx[self._free], n_m])
        Q, R_sqrt = qr(A, mode='economic')
        return _LinearizedAlignment(Q, R_sqrt, b)

    def step(self, at: _LinearizedAlignment, damping: float) -> tuple[Array, float]:
        """Solve R_sqrt dx = Q^T b; there is no damping."""
        diagonal = np.abs(np.diag(at.R_sqrt))
        if diagonal.min() <= MIN_DIAGONAL_RATIO * diagonal.max():
            raise SingularError('the observations do not determine the base node')
        y = at.Q.T @ at.b
        dx = np.zeros(self._sizes[-1] + 3)
        dx[self._free] = solve_triangular(at.R_sqrt, y)
        return dx, float(y @ y)

    def retract(self, x: _Nodes, dx: Array) -> _Nodes:
        x_p, x_q, b = x
        dx_p, dx_q, db = np.split(dx, self._sizes)
        return poses_plus(x_p, dx_p), poses_plus(x_q, dx_q), poses_plus(b[None], db)[0]

    def has_converged(self, x: _Nodes, dx: Array, decrease: float) -> bool:
        return bool(np.abs(dx).max() < ALIGNMENT_TOLERANCE)


def _decreases_of_chi_square(rows: Array, n: Array) -> Array:
    """
    Return n^T (I - Q Q^T)^-1 n (m,) for the rows (m, 2, c) of Q and the residuals n (m, 2).

    A' = Q R_sqrt. n alone is small where the maps give way to an outlier.

    """
    return distances_where_tested(n, np.eye(2) - rows @ rows.transpose(0, 2, 1))


def _base_node(
    p: RendezvousInformation, q: RendezvousInformation, x_p: Array, x_q: Array, b: Array
) -> tuple[Array, Array]:
    """Return the base node of the maps, given b between the middle poses, and its Jacobian."""
    start_p, start_q = x_p[p.start], x_q[q.start]
    q_in_p = compose(b, start_q)
    relative, back = between(start_p, q_in_p), inverse(q.origin)
    by_relative = pose_rotation(p.origin[2]) @ models.Phi(rotation(relative[2]) @ back[:2])
    H = by_relative @ models.H_pose(start_p[None], q_in_p[None])[0]
    G = np.zeros((3, x_p.size + x_q.size + 3))
    G[:, 3 * p.start:][:, :3] = H[:, :3]
    G[:, x_p.size + 3 * q.start:][:, :3] = H[:, 3:] @ pose_rotation(b[2])
    G[:, -3:] = H[:, 3:] @ models.Phi(q_in_p[:2] - b[:2])
    return compose(compose(p.origin, relative), back), G


def _connector(
    x_p: Array, x_q: Array, b: Array, observations: RendezvousObservations
) -> tuple[Array, Array]:
    """Return the whitened rows C_m and residuals n_m of all observations, eqs. (22) to (24)."""
    in_p = transform_poses(b, x_q)
    rows_p, rows_q, by_p = observations.p, observations.q, observations.by_p[:, None]
    x_i, x_j = x_p[rows_p], in_p[rows_q]
    observer, observed = np.where(by_p, x_i, x_j), np.where(by_p, x_j, x_i)
    H = models.H_pose(observer, observed)[:, :2]
    H_p = np.where(by_p[:, None], H[:, :, :3], H[:, :, 3:])
    H_q = np.where(by_p[:, None], H[:, :, 3:], H[:, :, :3])
    # Derivatives of the poses of q in the frame of p by themselves and by the base node.
    by_q, by_b = pose_rotation(b[2]), models.Phi_all(x_j[:, :2] - b[:2])
    C = np.zeros((len(H), 2, 3 * (len(x_p) + len(x_q)) + 3))
    C[:, :, -3:] = H_q @ by_b
    for m, (i, j) in enumerate(zip(rows_p, rows_q)):
        C[m, :, 3 * i:][:, :3] = H_p[m]
        C[m, :, 3 * (len(x_p) + j):][:, :3] = H_q[m] @ by_q
    n = observations.z - models.h(observer, observed[:, :2])
    L_inv = whitener(observations.R)
    return (L_inv @ C).reshape(-1, C.shape[-1]), (L_inv @ n[:, :, None]).ravel()
