# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Candidate pairs of an observation without ID and a landmark.

To accept a pair is to condition the innovations of all other pairs on its own. The gain of a pair
is the log-likelihood ratio of its innovation to an observation of an unknown object.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from fej_slam_ros.core.chi_square import chi_square_limit, squared_distances
from fej_slam_ros.core.ekf import numpy_kernel
from fej_slam_ros.core.ekf.kernel import KERNEL
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import JointState, Landmark, observation_columns, Robot
from fej_slam_ros.core.geometry import Array, Indices, perpendicular
from fej_slam_ros.core.records import Observation

#: Squared distance from which a pair is no candidate; of correct pairs one in a million.
MAX_PAIR_D2 = chi_square_limit(2, 1e-6)

#: Maximum number of candidate pairs of a scan; with more, all of them are ambiguous. Bounds time
#: and memory of the search.
MAX_CANDIDATE_PAIRS = 200

#: Mean square of theta^2 / 2 for a normal theta, in units of its squared variance.
SECOND_ORDER = 0.75

#: Indices of an observation and of a landmark.
Pair = tuple[int, int]


class Weights(NamedTuple):
    """Weights of k pairs, (k,) arrays."""

    d2: Array  #: squared Mahalanobis distances
    gains: Array  #: log-likelihood ratios to observations of unknown objects
    #: gains less log sqrt(det S / det R): a wrong pair does more harm the more it corrects
    penalised_gains: Array


@dataclass(frozen=True, eq=False)
class CandidatePairs:
    """Pairs that may be correct, given those that are accepted already."""

    #: observation, landmark: (k,) arrays, their indices
    observation: Indices
    landmark: Indices
    #: (k,) array, log of the expected number of observations of the landmark per observation of an
    #: unknown object in 2 pi m^2
    log_odds: Array
    noise: Array  #: (k,) array, log sqrt(det R) of the observations
    max_gain: Array  #: (k,) array, upper bound of the gain whatever other pairs are accepted
    r: Array  #: (2 k,) array, the innovations, all x before all y
    #: (2 k, 2 k) array, their joint covariance; meaningless between pairs of one observation, and
    #: empty of more than `MAX_CANDIDATE_PAIRS` pairs
    S: Array

    def __len__(self) -> int:
        return len(self.observation)

    def __getitem__(self, p: int) -> Pair:
        return int(self.observation[p]), int(self.landmark[p])

    def index(self, pair: Pair) -> int | None:
        """Return the index of a pair, None where it is no candidate."""
        found = np.flatnonzero((self.observation == pair[0]) & (self.landmark == pair[1]))
        return int(found[0]) if len(found) else None

    @cached_property
    def weights(self) -> Weights:
        """Return the weights of each pair by itself."""
        k, variances = len(self), self.S.diagonal()
        return self._weights(
            self.r[:k], self.r[k:], variances[:k], self.S[:k, k:].diagonal(), variances[k:])

    @cached_property
    def weights_given_others(self) -> Weights:
        """Return the weights of each pair conditioned on all the others."""
        k = len(self)
        # cho_solve of scipy 1.11 rejects a matrix without rows.
        information = cho_solve(cho_factor(self.S), np.eye(2 * k)) if k else self.S
        v = information @ self.r
        xx, yy = information.diagonal()[:k], information.diagonal()[k:]
        xy = information[:k, k:].diagonal()
        det = xx * yy - xy * xy
        return self._weights(
            (yy * v[:k] - xy * v[k:]) / det, (xx * v[k:] - xy * v[:k]) / det,
            yy / det, -xy / det, xx / det)

    def max_total_gain(self) -> float:
        """Return an upper bound of the gain of all pairs that are compatible with each other."""
        gains = np.zeros(self.observation.max(initial=-1) + 1)
        np.maximum.at(gains, self.observation, self.max_gain)
        return float(gains.sum())

    def conditioned_on(self, p: int) -> 'CandidatePairs':
        """
        Return the other pairs conditioned on pair p.

        Other pairs of its observation or its landmark are dropped, and pairs that become too
        distant.

        """
        k, others = len(self), np.flatnonzero(
            (self.observation != self.observation[p]) & (self.landmark != self.landmark[p]))
        rest, cross = self.subset(others), self.S[p::k, np.append(others, others + k)]
        (xx, xy), (_, yy) = self.S[p::k, p::k].tolist()
        gain = np.array([[yy, -xy], [-xy, xx]]) @ cross / (xx * yy - xy * xy)
        given = replace(rest, r=rest.r - self.r[p::k] @ gain, S=rest.S - cross.T @ gain)
        near = given.weights.d2 < MAX_PAIR_D2
        return given if near.all() else given.subset(np.flatnonzero(near))

    def subset(self, which: Indices) -> 'CandidatePairs':
        """Return some of the pairs, by their indices (k,), in the order given."""
        rows = np.append(which, which + len(self))
        return CandidatePairs(
            self.observation[which], self.landmark[which], self.log_odds[which],
            self.noise[which], self.max_gain[which], self.r[rows],
            self.S.take(rows, 0).take(rows, 1))

    def _weights(self, x: Array, y: Array, xx: Array, xy: Array, yy: Array) -> Weights:
        """Return the weights of innovations (x, y) with covariances [xx, xy; xy, yy]."""
        det = xx * yy - xy * xy
        d2: Array = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det
        spread = 0.5 * np.log(det)
        gains = self.log_odds - spread - 0.5 * d2
        return Weights(d2, gains, gains - spread + self.noise)


def candidate_pairs(
    state: JointState, linearization: Linearization, robot: Robot,
    observations: Sequence[Observation], landmarks: Sequence[Landmark], log_odds: Array,
) -> CandidatePairs:
    """
    Return all pairs within MAX_PAIR_D2; above `MAX_CANDIDATE_PAIRS` without their covariance.

    Parameters
    ----------
    state, linearization : of the filter
    robot : the observer
    observations : m observations
    landmarks : l landmarks that these may be of
    log_odds : (l,) array, as in `CandidatePairs`

    """
    if not landmarks:
        none, empty = np.empty(0, np.intp), np.empty(0)
        return CandidatePairs(none, none, empty, empty, empty, empty, np.empty((0, 0)))
    columns = observation_columns([robot] * len(landmarks), landmarks)
    H = KERNEL.H(linearization.observation_points(state, columns))
    z, R = np.array([s.z for s in observations]), np.array([s.R for s in observations])
    r = z[:, None] - KERNEL.h(state.estimates_of(columns))
    # Cheap tests come first: d2 is at least |r|^2 / tr S.
    distance2, trace_R = np.square(r).sum(axis=2), np.trace(R, axis1=1, axis2=2)
    i, f = np.nonzero(distance2 < MAX_PAIR_D2 * (
        _trace_bounds(state, robot, H, columns) + trace_R[:, None]))
    near, f_near = np.unique(f, return_inverse=True)
    HP = H[near] @ state.covariance.blocks(columns[near])
    second = _second_order_sigma(HP[:, :, 2])
    HPH = HP @ H[near].transpose(0, 2, 1) + second[:, :, None] * second[:, None]
    is_candidate = squared_distances(r[i, f], HPH[f_near] + R[i]) < MAX_PAIR_D2
    i, f, second = i[is_candidate], f[is_candidate], second[f_near[is_candidate]]
    pairs = CandidatePairs(
        i, f, log_odds[f], 0.5 * np.log(np.linalg.det(R))[i], log_odds[f], r[i, f].T.ravel(),
        np.empty((0, 0)))
    if len(pairs) > MAX_CANDIDATE_PAIRS:
        return pairs
    S, common = _innovation_covariance(state, H[f], columns[f], R[i]), second.T.ravel()
    pairs = replace(pairs, S=S + np.outer(common, common))
    d2, gains, _ = pairs.weights_given_others
    return replace(pairs, max_gain=gains + 0.5 * d2)


def _trace_bounds(state: JointState, robot: Robot, H: Array, columns: Indices) -> Array:
    """
    Return upper bounds (l,) of tr H P H^T, with its second-order term, of observations by a robot.

    The variance of a sum is at most twice the sum of the variances, here of robot and landmark;
    the square of a covariance is at most the product of the variances.

    """
    P = state.marginal([robot])
    of_robot = np.einsum('lij,jk,lik->l', H[:, :, :3], P, H[:, :, :3])
    first_order = 2.0 * (of_robot + state.covariance.variance_bounds(columns[:, 3:]))
    bounds: Array = (1.0 + SECOND_ORDER * P[2, 2]) * first_order
    return bounds


def _second_order_sigma(covariances: Array) -> Array:
    """
    Return the second-order error (l, 2) of l innovations as that of one common standard normal.

    An error theta of the heading, of variance s, turns an innovation by a theta, where a s is its
    covariance with theta, H P e, (l, 2). The next term of the rotation is J a theta^2 / 2. It is
    zero for landmarks that turn with the robot, and common to all observations of a scan.

    """
    return math.sqrt(SECOND_ORDER) * perpendicular(covariances)


def _innovation_covariance(state: JointState, H: Array, columns: Indices, R: Array) -> Array:
    """Return the covariance (2 k, 2 k) of the innovations of k pairs, all x before all y."""
    touched, compact = numpy_kernel.compact(columns, H, len(state.x_hat))
    k = len(H)
    compact = np.concatenate([compact[::2], compact[1::2]])
    S: Array = compact @ state.covariance.blocks(touched[None])[0] @ compact.T
    rows = np.arange(2 * k).reshape(2, k).T[:, :, None]
    S[rows, rows.transpose(0, 2, 1)] += R
    return S
