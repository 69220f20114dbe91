# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which landmark a sighting without identity is of.

All sightings of a scan are matched together, because they err together: joint compatibility,
[Neira] Neira, Tardos, Data association in stochastic mapping using the joint compatibility test,
2001. A hypothesis is what pairs of sightings and landmarks are right together, all else being
sightings of something unknown; so where the robot is uncertain a lone pair says nothing and
several that agree say much.

No match is better than a doubtful one: where another hypothesis is nearly as likely, a sighting is
of no use, neither for a landmark of the map nor as a new one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
import math

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import chdtri

from fej_slam_ros.core.gating import own_blocks
from fej_slam_ros.core.linearization import Linearization
from fej_slam_ros.core.pairs import Pair, Pairs, possible_pairs, weighed
from fej_slam_ros.core.records import Sighting
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.state import JointState, Landmark, Robot

#: A match is doubtful where another one is less than so many times less likely, as a log,
DOUBTFUL_WITHIN = math.log(100.0)
#: or where it is for something unknown.
UNKNOWN_WITHIN = math.log(20.0)

#: So many pairs are looked at as the seed of another hypothesis; among more nothing is certain.
MAX_SEEDS = 300


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


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Pairs that are right together, and what each speaks for itself given those before it."""

    pairs: tuple[Pair, ...] = ()
    gains: tuple[float, ...] = ()

    @property
    def score(self) -> float:
        """Return how much likelier it is than that all is unknown, as a log."""
        return sum(self.gains)

    def and_also(self, pair: Pair, gain: float) -> 'Hypothesis':
        """Return it with one more pair."""
        return Hypothesis((*self.pairs, pair), (*self.gains, gain))

    def likely_begin(self) -> tuple[Pair, ...]:
        """Return the pairs from each of which on the rest is likelier than something unknown."""
        rest = [*accumulate(reversed(self.gains))][::-1]
        return tuple(pair for pair, gain in zip(self.pairs, rest) if gain > UNKNOWN_WITHIN)


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
        sightings: Sequence[Sighting], landmarks: Sequence[Landmark], odds: Array,
    ) -> Matches:
        """
        Return what a robot's sightings are of, if of one of the landmarks or of none.

        The parameters are those of `possible_pairs`.

        """
        left = possible_pairs(state, linearization, robot, sightings, landmarks, odds)
        matched: dict[int, Landmark] = {}
        sum_d2 = 0.0
        for pair in certain(left):
            p = left.index(pair)
            if p is None:
                continue
            d2 = sum_d2 + float(left.weighed()[0][p])
            if d2 - sum_d2 <= self._limit(1) and d2 <= self._limit(len(matched) + 1):
                matched[pair[0]], sum_d2 = landmarks[pair[1]], d2
                left = left.believing(p)
        doubtful = {*left.sighting.tolist()}
        return Matches(
            matched,
            [i for i in range(len(sightings)) if not (i in doubtful or i in matched)],
            sorted(doubtful), [landmarks[f] for f in np.unique(left.landmark)])

    def _limit(self, count: int) -> float:
        """Return the largest squared distance of so many pairs together."""
        return float(chdtri(2 * count, self._tail))


def certain(pairs: Pairs) -> list[Pair]:
    """Return the pairs of the likeliest hypothesis that no other one puts into doubt."""
    found = [completed(Hypothesis(), pairs)]
    best = found[0]
    _, gains = pairs.weighed()
    for p in range(len(pairs)):
        if not any(pairs[p] in hypothesis.pairs for hypothesis in found):
            other = completed(
                Hypothesis().and_also(pairs[p], float(gains[p])), pairs.believing(p),
                best.score - DOUBTFUL_WITHIN)
            if other.score > best.score - DOUBTFUL_WITHIN:
                found.append(other)
                best = max(best, other, key=lambda hypothesis: hypothesis.score)
    undoubted = {*best.likely_begin()}.intersection(
        *(other.pairs for other in found if other.score > best.score - DOUBTFUL_WITHIN))
    return [
        pair for pair, gain in zip(best.pairs, gains_given_others(pairs, best.pairs))
        if pair in undoubted and gain > UNKNOWN_WITHIN]


def completed(begun: Hypothesis, left: Pairs, floor: float = -math.inf) -> Hypothesis:
    """
    Return a hypothesis with all that goes with it, what speaks most for itself first.

    Parameters
    ----------
    begun : what is believed already
    left : all other pairs, given that
    floor : a hypothesis that cannot come to this score need not be completed

    """
    while len(left) and begun.score + left.most_to_gain() > floor:
        _, gains = left.weighed()
        p = int(np.argmax(gains))
        if gains[p] <= 0.0:
            break
        begun, left = begun.and_also(left[p], float(gains[p])), left.believing(p)
    return begun


def gains_given_others(pairs: Pairs, believed: Sequence[Pair]) -> Array:
    """Return what each of some pairs speaks for itself when all the others are right, (n,)."""
    which = [p for p in range(len(pairs)) if pairs[p] in believed]
    which.sort(key=lambda p: believed.index(pairs[p]))
    rows = (2 * np.array(which, np.intp)[:, None] + np.arange(2)).ravel()
    information = cho_solve(cho_factor(pairs.S[np.ix_(rows, rows)]), np.eye(len(rows)))
    own = np.linalg.inv(own_blocks(information))
    r = np.einsum('kij,kj->ki', own, (information @ pairs.r[rows]).reshape(-1, 2))
    return weighed(r, own, pairs.odds[which])[1]
