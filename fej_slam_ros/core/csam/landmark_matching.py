# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Association: landmarks of aligned maps that are one and the same.

Algorithm 2 of [Andersson], with "uniquely matched" taken at its word: two landmarks match where
each is the only one of its robot inside the gate of the other. Every match makes the maps fit
better, so that it is repeated until no match is new. What was matched one by one is then checked
jointly, by how much it has raised chi-square; a pair that does not fit the others is released. In
one pass, with nearest neighbours, half of all runs would have a false match, which bends maps.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from fej_slam_ros.core.chi_square import own_blocks, squared_distances
from fej_slam_ros.core.csam.maps import JointMap, LandmarkPair
from fej_slam_ros.core.geometry import Array, Flags, Indices
from fej_slam_ros.core.records import LandmarkKey

#: A right pair is inside its gate with this probability.
GATE = 0.99
#: All pairs together raise chi-square beyond this probability only where one is wrong.
JOINTLY = 0.999


def match_landmarks(aligned: JointMap) -> JointMap:
    """
    Return a map in which landmarks that are the same are one.

    Parameters
    ----------
    aligned : the minimum over maps that were joined by their base nodes

    """
    pairs: list[LandmarkPair] = []
    released: set[LandmarkPair] = set()
    joined = aligned
    while True:
        new = [pair for pair in _unique_pairs(aligned, joined) if pair not in released]
        if not new:
            wrong = _misfit(aligned, joined, pairs) if pairs else None
            if wrong is None:
                return joined
            released.add(wrong)
        pairs = [pair for pair in [*pairs, *new] if pair not in released]
        joined = aligned.with_one_of(pairs, joined)


def _unique_pairs(aligned: JointMap, joined: JointMap) -> list[LandmarkPair]:
    """Return the pairs of landmarks of which each is the only one in the other's gate."""
    points, may_match = joined.values.points, _may_match(joined.landmarks)
    if not may_match.any():
        return []
    P = joined.information().joint(points=range(len(points)))
    distances = _distances(points, P)
    inside = (distances < chi2.ppf(GATE, 2)) & may_match
    # How many in the gate of the first are of a robot that the second is of.
    rivals = inside.astype(float) @ ~may_match
    found = np.argwhere(np.triu(inside & (rivals == 1) & (rivals.T == 1)))
    numbers = aligned.numbers()
    return [
        (numbers[joined.landmarks[i][0]], numbers[joined.landmarks[j][0]])
        for i, j in _apart(found[np.argsort(distances[tuple(found.T)])])]


def _apart(pairs: Indices) -> Iterator[LandmarkPair]:
    """Yield the pairs that have no landmark in common with one before."""
    taken: set[int] = set()
    for i, j in pairs.tolist():
        if taken.isdisjoint((i, j)):
            taken |= {i, j}
            yield i, j


def _distances(points: Array, P: Array) -> Array:
    """Return the squared Mahalanobis distance (l, l) between all landmarks, eq. (26)."""
    r = points[:, None] - points
    blocks = P.reshape(len(points), 2, len(points), 2).transpose(0, 2, 1, 3)
    own = own_blocks(P)
    S = own[:, None] + own - blocks - blocks.transpose(0, 1, 3, 2)
    # Of a landmark and itself S is zero; such pairs are never asked for.
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    np.fill_diagonal(det, 1.0)
    square = (
        S[..., 1, 1] * r[..., 0] ** 2 - 2.0 * S[..., 0, 1] * r[..., 0] * r[..., 1]
        + S[..., 0, 0] * r[..., 1] ** 2)
    distances: Array = square / det
    return distances


def _may_match(landmarks: Sequence[tuple[LandmarkKey, ...]]) -> Flags:
    """Return which landmarks (l, l) may be the same: no robot has a number for both."""
    owners = sorted({owner for keys in landmarks for owner, _ in keys})
    numbered_by = np.array([
        [any(owner == name for name, _ in keys) for owner in owners] for keys in landmarks],
        bool).reshape(len(landmarks), len(owners))
    apart: Flags = ~(numbered_by[:, None] & numbered_by).any(axis=2)
    return apart


def _misfit(
    aligned: JointMap, joined: JointMap, pairs: Sequence[LandmarkPair]
) -> LandmarkPair | None:
    """Return the pair whose release lowers chi-square most, None where all pairs fit together."""
    raised = joined.chi_square - aligned.chi_square
    if raised <= chi2.ppf(JOINTLY, 2 * len(pairs)):
        return None
    first, second = np.array(pairs).T
    points = aligned.values.points
    r = (points[first] - points[second]).ravel()
    seen = np.unique(np.concatenate([first, second]))
    P = aligned.information().joint(points=seen.tolist())
    difference = _selection(seen, first) - _selection(seen, second)
    S = cho_factor(difference @ P @ difference.T)
    # Without pair k chi-square r^T S^-1 r is less by e_k^T W_kk^-1 e_k, W = S^-1, e = W r.
    W, e = cho_solve(S, np.eye(len(r))), cho_solve(S, r).reshape(-1, 2)
    return pairs[int(np.argmax(squared_distances(e, own_blocks(W))))]


def _selection(landmarks: Indices, chosen: Indices) -> Array:
    """Return the (2 k, 2 l) matrix that takes k chosen landmarks out of l sorted ones."""
    picks = np.zeros((len(chosen), len(landmarks)))
    picks[np.arange(len(chosen)), np.searchsorted(landmarks, chosen)] = 1.0
    return np.kron(picks, np.eye(2)).astype(float)
