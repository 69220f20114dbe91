# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which landmark a sighting without identity is of.

All sightings of a scan are matched together, because they err together: joint compatibility,
[Neira] Neira, Tardos, Data association in stochastic mapping using the joint compatibility test,
2001. Each pair of a sighting and a landmark has an innovation; to believe a pair is to condition
the innovations of all others on its own, so that what is left of them tells how well they go with
it. What a pair speaks for itself is how much likelier its innovation is than a sighting of
something unknown there; so where the robot is uncertain a lone pair says nothing and several that
agree say much.

No match is better than a doubtful one: where another hypothesis is nearly as likely, a sighting is
of no use, neither for a landmark of the map nor as a new one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import chdtri

from fej_slam_ros.core import models
from fej_slam_ros.core.covariance import Indices
from fej_slam_ros.core.gating import own_blocks, squared_distances
from fej_slam_ros.core.geometry import Array, Flags
from fej_slam_ros.core.linearization import Linearization
from fej_slam_ros.core.records import Sighting
from fej_slam_ros.core.state import JointState, Landmark, Robot

#: A sighting is of something new when it is so far, as a squared distance, from all that is known:
#: one right match in a million is.
NEW_FROM = float(chdtri(2, 1e-6))

#: A match is doubtful where another hypothesis is less than a hundred times less likely.
DOUBTFUL_WITHIN = float(np.log(100.0))

#: So many hypotheses of a scan are looked at; where that does not suffice nothing is certain.
MAX_SEEDS = 100

#: Indices of a sighting and of a landmark.
Pair = tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """
    Pairs of sightings and landmarks that may be one, given those that are believed already.

    Attributes
    ----------
    sighting, landmark : (k,) arrays, their indices
    r : (2 k,) array, the innovations
    S : (2 k, 2 k) array, their joint covariance; between pairs of one sighting without meaning

    """

    sighting: Indices
    landmark: Indices
    r: Array
    S: Array

    def distances(self) -> Array:
        """Return the squared Mahalanobis distance of each, (k,)."""
        return squared_distances(self.r.reshape(-1, 2), own_blocks(self.S))

    def some(self, which: Flags) -> 'Pairs':
        """Return some of them."""
        rows = np.repeat(which, 2)
        return Pairs(
            self.sighting[which], self.landmark[which], self.r[rows], self.S[np.ix_(rows, rows)])

    def believing(self, p: int) -> 'Pairs':
        """Return what is left when pair p is right, conditioned on it."""
        own = slice(2 * p, 2 * p + 2)
        gain = np.linalg.solve(self.S[own, own], self.S[own])
        given = Pairs(
            self.sighting, self.landmark, self.r - gain.T @ self.r[own],
            self.S - self.S[:, own] @ gain)
        return given.some(~self.rivals(p))

    def rivals(self, p: int) -> Flags:
        """Return which exclude pair p, and p itself: a sighting is of one landmark only."""
        flags: Flags = (self.sighting == self.sighting[p]) | (self.landmark == self.landmark[p])
        return flags

    def gains(self, density: float) -> Array:
        """Return how much likelier each is than a sighting of something unknown, as logs (k,)."""
        return log_ratio(self.r.reshape(-1, 2), own_blocks(self.S), density)

    def index(self, pair: Pair) -> int:
        """Return where a sighting with a landmark is."""
        return int(np.flatnonzero((self.sighting == pair[0]) & (self.landmark == pair[1]))[0])


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """
    What the sightings of a scan are of, by their indices.

    Attributes
    ----------
    landmarks : the landmark of each that is of one in the map
    new : those of none
    doubtful : those that may be of one or not, or of one or another
    maybe_seen : landmarks that a doubtful one may be of

    """

    landmarks: Mapping[int, Landmark]
    new: Sequence[int]
    doubtful: Sequence[int]
    maybe_seen: Sequence[Landmark]


class Matcher:
    """
    Finds the landmarks of sightings without identity.

    Parameters
    ----------
    probability : a right pair passes the test of its innovation with this probability, as do all
        right pairs of a scan together

    """

    def __init__(self, probability: float) -> None:
        self._tail = 1.0 - probability

    def match(
        self, state: JointState, linearization: Linearization, robot: Robot,
        sightings: Sequence[Sighting], landmarks: Sequence[Landmark],
    ) -> Matches:
        """Return what a robot's sightings are of, if of one of the landmarks or of none."""
        pairs = self._possible(state, linearization, robot, sightings, landmarks)
        reach = max(float(np.hypot(*s.z)) for s in sightings)
        density = len(sightings) / (np.pi * reach**2)
        certain = self._certain(pairs, density)
        left = pairs
        for pair in certain:
            left = left.believing(left.index(pair))
        left = left.some(left.distances() < NEW_FROM)
        unknown = {*left.sighting.tolist()}
        matched = {i: landmarks[f] for i, f in certain}
        return Matches(
            matched, [i for i in range(len(sightings)) if not (i in unknown or i in matched)],
            sorted(unknown), [landmarks[f] for f in np.unique(left.landmark)])

    def _certain(self, pairs: Pairs, density: float) -> list[Pair]:
        """Return the pairs of the best hypothesis that no other one puts into doubt."""
        best = self._completed(Hypothesis((), 0.0, 0.0), pairs, density)
        certain = {
            pair for pair, gain in zip(best.pairs, _gains(pairs, best.pairs, density))
            if gain > 0.0}
        near = pairs.some(pairs.distances() <= self._limit(1))
        seeds = [pair for pair in zip(near.sighting.tolist(), near.landmark.tolist())
                 if pair not in best.pairs]
        for seed in seeds[:MAX_SEEDS]:
            p = pairs.index(seed)
            begun = Hypothesis((), 0.0, 0.0).with_pair(pairs, p, density)
            other = self._completed(begun, pairs.believing(p), density)
            if best.score - other.score < DOUBTFUL_WITHIN:
                certain &= {*other.pairs}
        return [pair for pair in best.pairs if pair in certain and len(seeds) <= MAX_SEEDS]

    def _completed(self, begun: 'Hypothesis', left: Pairs, density: float) -> 'Hypothesis':
        """Return a hypothesis with all that goes with it, what speaks most for itself first."""
        while len(left.r):
            d2, gains = left.distances(), left.gains(density)
            gains[d2 > self._limit(1)] = -np.inf
            p = int(np.argmax(gains))
            if gains[p] <= 0.0 or begun.d2 + d2[p] > self._limit(len(begun.pairs) + 1):
                break
            begun, left = begun.with_pair(left, p, density), left.believing(p)
        return begun

    def _limit(self, count: int) -> float:
        """Return the largest squared distance of so many pairs together."""
        return float(chdtri(2 * count, self._tail))

    def _possible(
        self, state: JointState, linearization: Linearization, robot: Robot,
        sightings: Sequence[Sighting], landmarks: Sequence[Landmark],
    ) -> Pairs:
        """Return all pairs that are not too far apart to be anything but different."""
        if not landmarks:
            nothing = np.empty(0, np.intp)
            return Pairs(nothing, nothing, np.empty(0), np.empty((0, 0)))
        robots = [robot] * len(landmarks)
        H = models.H(*linearization.sighting_points(state, robots, landmarks))
        columns = np.hstack([state.indices(robots), state.positions(landmarks)])
        h = models.h(state.x_hat[columns[:, :3]], state.x_hat[columns[:, 3:]])
        own = H @ state.covariance.blocks(columns) @ H.transpose(0, 2, 1)
        z, R = np.array([s.z for s in sightings]), np.array([s.R for s in sightings])
        r = z[:, None] - h
        # d2 is at least |r|^2 / tr S.
        widest = np.trace(own, axis1=1, axis2=2) + np.trace(R, axis1=1, axis2=2)[:, None]
        i, f = np.nonzero(np.sum(r**2, axis=2) < NEW_FROM * widest)
        exact = squared_distances(r[i, f], own[f] + R[i]) < NEW_FROM if len(i) else i > 0
        i, f = i[exact], f[exact]
        return Pairs(i, f, r[i, f].ravel(), _joint(state, H[f], columns[f], R[i]))


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Pairs that are right together, their squared distance, and the log-likelihood ratio."""

    pairs: tuple[Pair, ...]
    d2: float
    score: float

    def with_pair(self, left: Pairs, p: int, density: float) -> 'Hypothesis':
        """Return it with one more pair, which is given those it has."""
        pair = int(left.sighting[p]), int(left.landmark[p])
        return Hypothesis(
            (*self.pairs, pair), self.d2 + float(left.distances()[p]),
            self.score + float(left.gains(density)[p]))


def _gains(pairs: Pairs, believed: Sequence[Pair], density: float) -> Array:
    """Return what each of some pairs speaks for itself, all others being right, (n,)."""
    starts = np.array([2 * pairs.index(pair) for pair in believed], dtype=np.intp)
    rows = (starts[:, None] + np.arange(2)).ravel()
    information = cho_solve(cho_factor(pairs.S[np.ix_(rows, rows)]), np.eye(len(rows)))
    own: Array = np.linalg.inv(own_blocks(information))
    r = np.einsum('kij,kj->ki', own, (information @ pairs.r[rows]).reshape(-1, 2))
    return log_ratio(r, own, density)


def log_ratio(r: Array, S: Array, density: float) -> Array:
    """Return log N(r; 0, S) / density of innovations (k, 2) with covariances (k, 2, 2)."""
    ratios: Array = -0.5 * (squared_distances(r, S) + np.log(np.linalg.det(S))) - np.log(
        2.0 * np.pi * density)
    return ratios


def _joint(state: JointState, H: Array, columns: Indices, R: Array) -> Array:
    """Return the covariance (2 k, 2 k) of the innovations of k pairs."""
    touched, place = np.unique(columns, return_inverse=True)
    k = len(H)
    compact = np.zeros((2 * k, len(touched)))
    rows = np.arange(2 * k).reshape(k, 2, 1)
    compact[rows, place.reshape(k, 1, 5)] = H
    S: Array = compact @ state.covariance.blocks(touched[None])[0] @ compact.T
    S[rows, rows.reshape(k, 1, 2)] += R
    return S
