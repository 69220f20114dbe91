# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Joint compatibility: the landmarks of all observations of a scan without IDs, matched together.

The observations share the error of the pose, [Neira] Neira, Tardos, Data association in stochastic
mapping using the joint compatibility test, 2001. A hypothesis is a set of pairs of observations
and landmarks; all other observations are of unknown objects. If the pose is uncertain, a single
pair carries little information, but several pairs that agree carry much.

An ambiguous match is worse than none: if another hypothesis is nearly as likely, an observation is
used neither for a landmark of the map nor for a new one.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
import math

import numpy as np

from fej_slam_ros.core.chi_square import chi_square_limit
from fej_slam_ros.core.data_association.candidate_pairs import (
    candidate_pairs, CandidatePairs, MAX_CANDIDATE_PAIRS, Pair)
from fej_slam_ros.core.ekf.linearization import Linearization
from fej_slam_ros.core.ekf.state import JointState, Landmark, Robot
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.pieces import pause
from fej_slam_ros.core.records import Observation

#: Log-likelihood ratio to the best hypothesis within which another one makes a match ambiguous.
AMBIGUITY_MARGIN = math.log(100.0)
#: Minimum penalised gain of a pair, below which its match is ambiguous.
MIN_GAIN = math.log(3.0)

#: Maximum squared Mahalanobis distance of the first pair of an alternative hypothesis; 99.9 % of
#: correct pairs are within it.
MAX_SEED_D2 = chi_square_limit(2, 1e-3)


@dataclass(frozen=True, slots=True, eq=False)
class MatchingResult:
    """Association of the observations of a scan, by their indices."""

    landmarks: Mapping[int, Landmark]  #: the landmark of each matched observation
    new: Sequence[int]  #: observations of unknown objects
    doubtful: Sequence[int]  #: ambiguous observations
    candidates: Sequence[Landmark]  #: possible landmarks of the ambiguous observations

    def without_matches(self) -> 'MatchingResult':
        """Return the result with all matched observations as ambiguous ones."""
        return MatchingResult(
            {}, self.new, sorted([*self.doubtful, *self.landmarks]),
            [*self.candidates, *self.landmarks.values()])


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """A set of compatible pairs."""

    pairs: tuple[Pair, ...] = ()  #: in the order in which they were accepted
    score: float = 0.0  #: log-likelihood ratio to the hypothesis without pairs
    penalised_gains: tuple[float, ...] = ()  #: of each pair, conditioned on those before it

    def extended(self, pairs: CandidatePairs, p: int) -> 'Hypothesis':
        """Return the hypothesis with pair p of the candidates conditioned on it."""
        weights = pairs.weights
        return Hypothesis(
            (*self.pairs, pairs[p]), self.score + float(weights.gains[p]),
            (*self.penalised_gains, float(weights.penalised_gains[p])))

    def likely_pairs(self) -> tuple[Pair, ...]:
        """Return the pairs whose gain, added to those of all later pairs, is sufficient."""
        sums = [*accumulate(reversed(self.penalised_gains))][::-1]
        return tuple(pair for pair, gain in zip(self.pairs, sums) if gain > MIN_GAIN)


def match_scan(
    state: JointState, linearization: Linearization, robot: Robot,
    observations: Sequence[Observation], landmarks: Sequence[Landmark], log_odds: Array,
    probability: float,
) -> MatchingResult:
    """
    Return the landmarks of a robot's observations without ID; parameters as of `candidate_pairs`.

    A correct pair passes the individual test with the given probability, and all correct pairs of
    a scan pass the joint one.

    """
    rest = candidate_pairs(state, linearization, robot, observations, landmarks, log_odds)
    matched: dict[int, Landmark] = {}
    sum_d2, tail = 0.0, 1.0 - probability
    for pair in unambiguous_pairs(rest):
        p = rest.index(pair)
        if p is None:
            continue
        d2 = float(rest.weights.d2[p])
        if d2 <= chi_square_limit(2, tail) and sum_d2 + d2 <= chi_square_limit(
                2 * (len(matched) + 1), tail):
            matched[pair[0]], sum_d2 = landmarks[pair[1]], sum_d2 + d2
            rest = rest.conditioned_on(p)
    doubtful = {*rest.observation.tolist()}
    return MatchingResult(
        matched, [i for i in range(len(observations)) if not (i in doubtful or i in matched)],
        sorted(doubtful), [landmarks[f] for f in np.unique(rest.landmark)])


def unambiguous_pairs(pairs: CandidatePairs) -> list[Pair]:
    """Return the pairs of the best hypothesis that no likely other one contradicts, in order."""
    if len(pairs) > MAX_CANDIDATE_PAIRS:
        return []
    hypotheses = [completed(Hypothesis(), pairs)]
    best = hypotheses[0]
    for p in np.flatnonzero(pairs.weights.d2 < MAX_SEED_D2).tolist():
        if pause():
            return []
        if not any(pairs[p] in hypothesis.pairs for hypothesis in hypotheses):
            seed = Hypothesis().extended(pairs, p)
            other = completed(seed, pairs.conditioned_on(p), best.score - AMBIGUITY_MARGIN)
            if other.score > best.score - AMBIGUITY_MARGIN:
                hypotheses.append(other)
                best = max(best, other, key=lambda hypothesis: hypothesis.score)
    common = {*best.likely_pairs()}.intersection(*(
        other.pairs for other in hypotheses if other.score > best.score - AMBIGUITY_MARGIN))
    accepted = pairs.subset(np.array([pairs.index(pair) for pair in best.pairs], np.intp))
    gains = accepted.weights_given_others.penalised_gains
    return [pair for pair, gain in zip(best.pairs, gains) if pair in common and gain > MIN_GAIN]


def completed(
    hypothesis: Hypothesis, rest: CandidatePairs, min_score: float = -math.inf
) -> Hypothesis:
    """
    Return a hypothesis with all compatible pairs, the pair with the largest gain first.

    Parameters
    ----------
    hypothesis : the pairs accepted already
    rest : all other pairs, conditioned on these
    min_score : the search ends as soon as this score can no longer be reached

    """
    while len(rest) and hypothesis.score + rest.max_total_gain() > min_score:
        p = int(np.argmax(rest.weights.gains))
        if rest.weights.gains[p] <= 0.0:
            break
        hypothesis, rest = hypothesis.extended(rest, p), rest.conditioned_on(p)
    return hypothesis
