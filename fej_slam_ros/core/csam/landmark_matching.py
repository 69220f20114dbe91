# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Algorithm 2 of [Andersson]: duplicate landmarks of aligned maps.

"Uniquely matched" is taken literally: two landmarks match if each is the only landmark of its
robot inside the gate of the other. Each match improves the fit of the maps, so that matching is
repeated until there are no new pairs. Then all pairs are tested jointly by their increase of
chi-square, and a pair that does not fit the others is released. A single pass with nearest
neighbours would have a false match in half of all runs.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.stats import chi2

from fej_slam_ros.core.chi_square import own_blocks, squared_distances
from fej_slam_ros.core.csam.maps import JointMap, LandmarkPair
from fej_slam_ros.core.geometry import Array, Flags, Indices
from fej_slam_ros.core.records import LandmarkKey

#: Probability that a correct pair is inside its gate, xi of Algorithm 2.
PAIR_PROBABILITY = 0.99
#: Probability that correct pairs together pass the joint test.
JOINT_PROBABILITY = 0.999


def match_landmarks(aligned: JointMap) -> JointMap:
    """
    Return the map in which duplicate landmarks are merged, Algorithm 2.

    Parameters
    ----------
    aligned : the minimum of maps that were joined by their base nodes

    """
    pairs: list[LandmarkPair] = []
    released: set[LandmarkPair] = set()
    matched = aligned
    while True:
        # 1. Unique pairs inside the gate, eq. (26).
        new = [pair for pair in _unique_pairs(aligned, matched) if pair not in released]
        if not new:
            # 2. Joint test; release the worst pair.
            worst = _misfit(aligned, matched, pairs) if pairs else None
            if worst is None:
                return matched
            released.add(worst)
        # 3. Merge the landmarks of all pairs and solve eq. (2) again.
        pairs = [pair for pair in [*pairs, *new] if pair not in released]
        matched = aligned.with_merged_landmarks(pairs, matched)


def _unique_pairs(aligned: JointMap, matched: JointMap) -> list[LandmarkPair]:
    """Return the pairs of landmarks each of which is the only one in the other's gate."""
    points, may_match = matched.values.points, _may_match(matched.landmarks)
    if not may_match.any():
        return []
    P = matched.information().joint(points=range(len(points)))
    d2 = _squared_distances(points, P)
    inside = (d2 < chi2.ppf(PAIR_PROBABILITY, 2)) & may_match
    # Landmarks in the gate of the first that share a robot with the second.
    rivals = inside.astype(float) @ ~may_match
    pairs = np.argwhere(np.triu(inside & (rivals == 1) & (rivals.T == 1)))
    index = aligned.landmark_index()
    return [
        (index[matched.landmarks[i][0]], index[matched.landmarks[j][0]])
        for i, j in _disjoint(pairs[np.argsort(d2[tuple(pairs.T)])])]


def _disjoint(pairs: Indices) -> Iterator[LandmarkPair]:
    """Yield the pairs that have no landmark in common with an earlier one."""
    taken: set[int] = set()
    for i, j in pairs.tolist():
        if taken.isdisjoint((i, j)):
            taken |= {i, j}
            yield i, j


def _squared_distances(points: Array, P: Array) -> Array:
    """Return the squared Mahalanobis distances (l, l) of all landmarks, eq. (26)."""
    r = points[:, None] - points
    blocks = P.reshape(len(points), 2, len(points), 2).transpose(0, 2, 1, 3)
    own = own_blocks(P)
    S = own[:, None] + own - blocks - blocks.transpose(0, 1, 3, 2)
    # S of a landmark and itself is zero; such pairs are not used.
    det = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    np.fill_diagonal(det, 1.0)
    d2: Array = (
        S[..., 1, 1] * r[..., 0] ** 2 - 2.0 * S[..., 0, 1] * r[..., 0] * r[..., 1]
        + S[..., 0, 0] * r[..., 1] ** 2) / det
    return d2


def _may_match(landmarks: Sequence[tuple[LandmarkKey, ...]]) -> Flags:
    """Return the pairs of landmarks (l, l) without a common robot."""
    owners = sorted({owner for keys in landmarks for owner, _ in keys})
    has_owner = np.array([
        [any(owner == name for name, _ in keys) for owner in owners] for keys in landmarks],
        bool).reshape(len(landmarks), len(owners))
    apart: Flags = ~(has_owner[:, None] & has_owner).any(axis=2)
    return apart


def _misfit(
    aligned: JointMap, matched: JointMap, pairs: Sequence[LandmarkPair]
) -> LandmarkPair | None:
    """Return the pair whose release lowers chi-square most, None if all pairs fit together."""
    increase = matched.chi_square - aligned.chi_square
    if increase <= chi2.ppf(JOINT_PROBABILITY, 2 * len(pairs)):
        return None
    first, second = np.array(pairs).T
    points = aligned.values.points
    r = (points[first] - points[second]).ravel()
    landmarks = np.unique(np.concatenate([first, second]))
    P = aligned.information().joint(points=landmarks.tolist())
    H = _selection(landmarks, first) - _selection(landmarks, second)
    S = cho_factor(H @ P @ H.T)
    # Without pair k chi-square r^T S^-1 r is less by e_k^T W_kk^-1 e_k, W = S^-1, e = W r.
    W, e = cho_solve(S, np.eye(len(r))), cho_solve(S, r).reshape(-1, 2)
    return pairs[int(np.argmax(squared_distances(e, own_blocks(W))))]


def _selection(landmarks: Indices, chosen: Indices) -> Array:
    """Return the (2 k, 2 l) matrix that selects k chosen landmarks from l sorted ones."""
    picks = np.zeros((len(chosen), len(landmarks)))
    picks[np.arange(len(chosen)), np.searchsorted(landmarks, chosen)] = 1.0
    return np.kron(picks, np.eye(2)).astype(float)
