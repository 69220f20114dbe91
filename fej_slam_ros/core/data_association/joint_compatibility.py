# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Which landmark an observation without identity is of.

All observations of a scan are matched together, because they err together: joint compatibility,
[Neira] Neira, Tardos, Data association in stochastic mapping using the joint compatibility test,
2001. A hypothesis is what pairs of observations and landmarks are right together, all else being
observations of something unknown; so where the robot is uncertain a lone pair says nothing and
several that agree say much.

No match is better than a doubtful one: where another hypothesis is nearly as likely, an observation is
of no use, neither for a landmark of the map nor as a new one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
import math

import numpy as np
from scipy.special import chdtri

from fej_slam_ros.core.data_association.candidate_pairs import (
    candidate_pairs, CandidatePairs, Pair)
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import Observation

#: A match is doubtful where another hypothesis is less than so many times less likely, as a log,
DOUBTFUL_WITHIN = math.log(100.0)
#: or where it speaks for itself, cautiously, by less than that.
MIN_GAIN = math.log(3.0)

#: Other hypotheses begin with a pair no farther than one right pair in a thousand is.
SEED_WITHIN = float(chdtri(2, 1e-3))

#: Where so many pairs are possible nothing is certain.
MAX_PAIRS = 200


@dataclass(frozen=True, slots=True, eq=False)
class MatchingResult:
    """What the observations of a scan are of, by their indices."""

    landmarks: Mapping[int, Landmark]  #: the landmark of each that is of one in the map
    new: Sequence[int]  #: those of none
    doubtful: Sequence[int]  #: those that may be of one or not, or of one or another
    maybe_seen: Sequence[Landmark]  #: landmarks that a doubtful one may be of


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Pairs that are right together."""

    pairs: tuple[Pair, ...] = ()  #: in the order in which they are believed
    #: how much likelier they are than that all observations are of something unknown, as a log
    score: float = 0.0
    gains: tuple[float, ...] = ()  #: what each speaks for itself cautiously, given those before it

    def conditioned_on(self, pairs: CandidatePairs, p: int) -> 'Hypothesis':
        """Return it with one more of the pairs that are left."""
        weights = pairs.weights
        return Hypothesis(
            (*self.pairs, pairs[p]), self.score + float(weights.gains[p]),
            (*self.gains, float(weights.cautious[p])))

    def likely_pairs(self) -> tuple[Pair, ...]:
        """Return those that speak for themselves, each together with all that follow."""
        together = [*accumulate(reversed(self.gains))][::-1]
        return tuple(pair for pair, gain in zip(self.pairs, together) if gain > MIN_GAIN)


class JointCompatibilityMatcher:
    """
    Finds the landmarks of observations without identity.

    Parameters
    ----------
    probability : a right pair passes the test of its innovation with this probability, as do all
        right pairs of a scan together

    """

    def __init__(self, probability: float) -> None:
        self._tail = 1.0 - probability

    def match(
        self, state: JointState, linearization: Linearization, robot: Robot,
        observations: Sequence[Observation], landmarks: Sequence[Landmark], odds: Array,
    ) -> MatchingResult:
        """
        Return what a robot's observations are of, if of one of the landmarks or of none.

        The parameters are those of `possible_pairs`.

        """
        left = candidate_pairs(state, linearization, robot, observations, landmarks, odds)
        matched: dict[int, Landmark] = {}
        sum_d2 = 0.0
        for pair in certain(left):
            p = left.index(pair)
            if p is None:
                continue
            d2 = float(left.weights.d2[p])
            if d2 <= self._limit(1) and sum_d2 + d2 <= self._limit(len(matched) + 1):
                matched[pair[0]], sum_d2 = landmarks[pair[1]], sum_d2 + d2
                left = left.conditioned_on(p)
        doubtful = {*left.observation.tolist()}
        return MatchingResult(
            matched,
            [i for i in range(len(observations)) if not (i in doubtful or i in matched)],
            sorted(doubtful), [landmarks[f] for f in np.unique(left.landmark)])

    def _limit(self, count: int) -> float:
        """Return the largest squared distance of so many pairs together."""
        return float(chdtri(2 * count, self._tail))


def certain(pairs: CandidatePairs) -> list[Pair]:
    """Return the pairs of the likeliest hypothesis that nothing puts into doubt, in its order."""
    if len(pairs) > MAX_PAIRS:
        return []
    found = [completed(Hypothesis(), pairs)]
    best = found[0]
    for p in np.flatnonzero(pairs.weights.d2 < SEED_WITHIN).tolist():
        if not any(pairs[p] in hypothesis.pairs for hypothesis in found):
            begun = Hypothesis().conditioned_on(pairs, p)
            other = completed(begun, pairs.conditioned_on(p), best.score - DOUBTFUL_WITHIN)
            if other.score > best.score - DOUBTFUL_WITHIN:
                found.append(other)
                best = max(best, other, key=lambda hypothesis: hypothesis.score)
    undoubted = {*best.likely_pairs()}.intersection(*(
        other.pairs for other in found if other.score > best.score - DOUBTFUL_WITHIN))
    accepted = pairs.some(np.array([pairs.index(pair) for pair in best.pairs], np.intp))
    return [
        pair for pair, gain in zip(best.pairs, accepted.weights_given_others.cautious)
        if pair in undoubted and gain > MIN_GAIN]


def completed(begun: Hypothesis, left: CandidatePairs, floor: float = -math.inf) -> Hypothesis:
    """
    Return a hypothesis with all that goes with it, what speaks most for itself first.

    Parameters
    ----------
    begun : what is believed already
    left : all other pairs, given that
    floor : a hypothesis that cannot come to this score need not be completed

    """
    while len(left) and begun.score + left.most_to_gain() > floor:
        p = int(np.argmax(left.weights.gains))
        if left.weights.gains[p] <= 0.0:
            break
        begun, left = begun.conditioned_on(left, p), left.conditioned_on(p)
    return begun
