# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Pairs of an observation without identity and a landmark that it may be of.

To believe a pair is to condition the innovations of all others on its own: what is left of them
tells how well they go with it. What a pair speaks for itself is how much likelier its innovation
is than an observation of something unknown there, as a log.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import chdtri

from fej_slam_ros.core import models
from fej_slam_ros.core.chi_square import squared_distances
from fej_slam_ros.core.ekf.covariance import SparseRows
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import JointState, Landmark, observation_columns, Robot
from fej_slam_ros.core.geometry import Array, Indices
from fej_slam_ros.core.records import Observation

#: An observation is of something else than what is so far from it, as a squared distance: one right
#: pair in a million is.
FAR = float(chdtri(2, 1e-6))

#: Indices of an observation and of a landmark.
Pair = tuple[int, int]


class Weights(NamedTuple):
    """What pairs speak for themselves, (k,) arrays."""

    d2: Array  #: squared Mahalanobis distances
    gains: Array  #: how much likelier each is than an observation of something unknown, as a log
    #: the same, less log sqrt(det S / det R): the more a pair would tell beyond the noise of the
    #: observation itself, the more is lost if it is wrong
    cautious: Array


@dataclass(frozen=True, eq=False)
class CandidatePairs:
    """Pairs that may be right, given those that are believed already."""

    #: observation, landmark: (k,) arrays, their indices
    observation: Indices
    landmark: Indices
    #: (k,) array, log of how often the landmark is seen for once that something unknown is seen in
    #: 2 pi m^2
    odds: Array
    noise: Array  #: (k,) array, log sqrt(det R) of the observations
    most: Array  #: (k,) array, what each can speak for itself at most, whatever else is right
    r: Array  #: (2 k,) array, the innovations, first all x, then all y
    #: (2 k, 2 k) array, their joint covariance; between pairs of one observation without meaning
    S: Array

    def __len__(self) -> int:
        return len(self.observation)

    def __getitem__(self, p: int) -> Pair:
        return int(self.observation[p]), int(self.landmark[p])

    def index(self, pair: Pair) -> int | None:
        """Return which pair an observation and a landmark are, None where they are not left."""
        found = np.flatnonzero((self.observation == pair[0]) & (self.landmark == pair[1]))
        return int(found[0]) if len(found) else None

    @cached_property
    def weights(self) -> Weights:
        """Return what each speaks for itself."""
        k, variances = len(self), self.S.diagonal()
        return self._weights(
            self.r[:k], self.r[k:], variances[:k], self.S[:k, k:].diagonal(), variances[k:])

    @cached_property
    def weights_given_others(self) -> Weights:
        """Return what each speaks for itself when all the others are right, too."""
        k = len(self)
        information = cho_solve(cho_factor(self.S), np.eye(2 * k))
        v = information @ self.r
        xx, yy = information.diagonal()[:k], information.diagonal()[k:]
        xy = information[:k, k:].diagonal()
        det = xx * yy - xy * xy
        return self._weights(
            (yy * v[:k] - xy * v[k:]) / det, (xx * v[k:] - xy * v[:k]) / det,
            yy / det, -xy / det, xx / det)

    def most_to_gain(self) -> float:
        """Return what those that can be right together may speak for themselves at most."""
        most = np.zeros(self.observation.max(initial=-1) + 1)
        np.maximum.at(most, self.observation, self.most)
        return float(most.sum())

    def conditioned_on(self, p: int) -> 'CandidatePairs':
        """
        Return what is left when pair p is right, conditioned on it.

        An observation is of one landmark only, and what is far then is of something else.

        """
        k, others = len(self), np.flatnonzero(
            (self.observation != self.observation[p]) & (self.landmark != self.landmark[p]))
        left, cross = self.some(others), self.S[p::k, np.append(others, others + k)]
        (xx, xy), (_, yy) = self.S[p::k, p::k].tolist()
        gain = np.array([[yy, -xy], [-xy, xx]]) @ cross / (xx * yy - xy * xy)
        given = CandidatePairs(
            left.observation, left.landmark, left.odds, left.noise, left.most,
            left.r - self.r[p::k] @ gain, left.S - cross.T @ gain)
        near = given.weights.d2 < FAR
        return given if near.all() else given.some(np.flatnonzero(near))

    def some(self, which: Indices) -> 'CandidatePairs':
        """Return some of them, in the order given."""
        rows = np.append(which, which + len(self))
        return CandidatePairs(
            self.observation[which], self.landmark[which], self.odds[which], self.noise[which],
            self.most[which], self.r[rows], self.S.take(rows, 0).take(rows, 1))

    def _weights(self, x: Array, y: Array, xx: Array, xy: Array, yy: Array) -> Weights:
        """Return those of innovations (x, y) with the covariances [xx, xy; xy, yy]."""
        det = xx * yy - xy * xy
        d2: Array = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / det
        spread = 0.5 * np.log(det)
        gains = self.odds - spread - 0.5 * d2
        return Weights(d2, gains, gains - spread + self.noise)


def candidate_pairs(
    state: JointState, linearization: Linearization, robot: Robot,
    observations: Sequence[Observation], landmarks: Sequence[Landmark], odds: Array,
) -> CandidatePairs:
    """
    Return all pairs that are not far from each other.

    Parameters
    ----------
    state, linearization : of the filter, with all that follows
    robot : who saw
    observations : m that it made
    landmarks : l that these may be of
    odds : (l,) array, as in `Pairs`

    """
    if not landmarks:
        nothing = np.empty(0, np.intp)
        return CandidatePairs(nothing, nothing, odds, odds, odds, np.empty(0), np.empty((0, 0)))
    sighted = observation_columns([robot] * len(landmarks), landmarks)
    columns = sighted.columns
    H = models.H(*linearization.observation_points(state, sighted))
    own = H @ state.covariance.blocks(columns) @ H.transpose(0, 2, 1)
    z, R = np.array([s.z for s in observations]), np.array([s.R for s in observations])
    x = state.estimates_of(columns)
    r = z[:, None] - models.h(x[:, :3], x[:, 3:])
    # d2 is at least |r|^2 / tr S.
    widest = np.trace(own, axis1=1, axis2=2) + np.trace(R, axis1=1, axis2=2)[:, None]
    i, f = np.nonzero(r[:, :, 0] ** 2 + r[:, :, 1] ** 2 < FAR * widest)
    near = squared_distances(r[i, f], own[f] + R[i]) < FAR
    i, f = i[near], f[near]
    noise = 0.5 * np.log(np.linalg.det(R))[i]
    pairs = CandidatePairs(
        i, f, odds[f], noise, odds[f], r[i, f].T.ravel(), _joint(state, H[f], columns[f], R[i]))
    d2, gains, _ = pairs.weights_given_others
    return replace(pairs, most=gains + 0.5 * d2)


def _joint(state: JointState, H: Array, columns: Indices, R: Array) -> Array:
    """Return the covariance (2 k, 2 k) of the innovations of k pairs, all x before all y."""
    touched, compact = SparseRows(columns, H).compact(len(state.x_hat))
    k = len(H)
    compact = np.concatenate([compact[::2], compact[1::2]])
    S: Array = compact @ state.covariance.blocks(touched[None])[0] @ compact.T
    rows = np.arange(2 * k).reshape(2, k).T[:, :, None]
    S[rows, rows.transpose(0, 2, 1)] += R
    return S
