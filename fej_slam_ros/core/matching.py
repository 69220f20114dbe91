# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which landmark a sighting without identity is of: joint compatibility branch and bound.

All sightings of a scan are matched together, because they err together: [Neira] Neira, Tardos,
Data association in stochastic mapping using the joint compatibility test, 2001. Each pair of a
sighting and a landmark has an innovation; to believe a pair is to condition the innovations of all
others on its own, so that what is left of them tells how well they go with it.

No match is better than a doubtful one: where another hypothesis is nearly as likely, a sighting is
of no use, neither for a landmark of the map nor as a new one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
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

#: A match is doubtful where without it another one is less than a hundred times less likely.
DOUBTFUL_WITHIN = 2.0 * float(np.log(100.0))

#: So many hypotheses of a scan are looked at; where that does not suffice nothing is certain.
MAX_HYPOTHESES = 2000


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

    def index(self, pair: tuple[int, int]) -> int | None:
        """Return where a sighting with a landmark is, None where it is not here."""
        found = np.flatnonzero((self.sighting == pair[0]) & (self.landmark == pair[1]))
        return int(found[0]) if len(found) else None


@dataclass(frozen=True, slots=True, eq=False)
class Matches:
    """
    What the sightings of a scan are of, by their indices.

    Attributes
    ----------
    landmarks : the landmark of each that is of one in the map
    new : those of none
    doubtful : those that may be of one or not, or of one or another

    """

    landmarks: dict[int, Landmark]
    new: list[int]
    doubtful: list[int]


class Matcher:
    """
    Finds the landmarks of sightings without identity.

    Parameters
    ----------
    probability : all right pairs of a scan pass the joint test with this probability

    """

    def __init__(self, probability: float) -> None:
        self._tail = 1.0 - probability

    def match(
        self, state: JointState, linearization: Linearization, robot: Robot,
        sightings: Sequence[Sighting], landmarks: Sequence[Landmark],
    ) -> Matches:
        """Return what a robot's sightings are of, if of one of the landmarks or of none."""
        pairs = self._possible(state, linearization, robot, sightings, landmarks)
        near = pairs.some(pairs.distances() <= self._limit(1))
        best = _Search(self._limit).best(near)
        if best is None:
            return Matches({}, [], [*range(len(sightings))])
        certain = [pair for pair in best if not self._is_doubtful(near, best, pair)]
        left = _given(pairs, best)
        left = left.some(left.distances() < NEW_FROM)
        unknown = {i for i, _ in best} | set(left.sighting.tolist())
        return Matches(
            {i: landmarks[f] for i, f in certain},
            [i for i in range(len(sightings)) if i not in unknown],
            sorted(unknown - {i for i, _ in certain}))

    def _limit(self, count: int) -> float:
        """Return the largest squared distance of so many pairs together."""
        return float(chdtri(2 * count, self._tail))

    def _is_doubtful(
        self, pairs: Pairs, best: Sequence[tuple[int, int]], pair: tuple[int, int]
    ) -> bool:
        """Return whether a rival of a pair is nearly as good, all else being right."""
        p = pairs.index(pair)
        assert p is not None
        rivals = pairs.some(pairs.rivals(p))
        if len(rivals.r) == 2:
            return False
        touched = {*rivals.sighting.tolist()}, {*rivals.landmark.tolist()}
        others = [
            (i, f) for i, f in best if i not in touched[0] and f not in touched[1]]
        given = _given(pairs, others)
        p = given.index(pair)
        if p is None:
            return True
        d2 = given.distances()
        rival = given.rivals(p)
        rival[p] = False
        return bool((d2[rival] - d2[p] < DOUBTFUL_WITHIN).any())

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


class _Search:
    """
    Branch and bound over the hypotheses of a scan: the most pairs, then the nearest.

    Parameters
    ----------
    limit : gives the largest squared distance of so many pairs together

    """

    def __init__(self, limit: Callable[[int], float]) -> None:
        self._limit = limit
        self._best: list[tuple[int, int]] = []
        self._d2 = 0.0
        self._looked_at = 0

    def best(self, pairs: Pairs) -> list[tuple[int, int]] | None:
        """Return the pairs of the best hypothesis, None where there are too many."""
        self._explore([], 0.0, pairs)
        return self._best if self._looked_at <= MAX_HYPOTHESES else None

    def _explore(self, chosen: list[tuple[int, int]], d2: float, left: Pairs) -> None:
        self._looked_at += 1
        if self._looked_at > MAX_HYPOTHESES:
            return
        if len(chosen) > len(self._best) or (len(chosen) == len(self._best) and d2 < self._d2):
            self._best, self._d2 = chosen, d2
        possible = len(chosen) + len(np.unique(left.sighting))
        if len(left.r) == 0 or possible < len(self._best) or (
            possible == len(self._best) and d2 >= self._d2
        ):
            return
        added = left.distances()
        first = left.sighting[np.argmin(added)]
        of_first = np.flatnonzero(left.sighting == first)
        for p in of_first[np.argsort(added[of_first], kind='stable')]:
            if d2 + added[p] <= self._limit(len(chosen) + 1):
                pair = int(first), int(left.landmark[p])
                self._explore([*chosen, pair], d2 + float(added[p]), left.believing(int(p)))
        self._explore(chosen, d2, left.some(left.sighting != first))


def _given(pairs: Pairs, believed: Sequence[tuple[int, int]]) -> Pairs:
    """Return what is left of pairs when some of them are right."""
    for pair in believed:
        p = pairs.index(pair)
        assert p is not None
        pairs = pairs.believing(p)
    return pairs


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
