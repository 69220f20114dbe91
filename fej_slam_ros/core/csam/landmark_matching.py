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

from fej_slam_ros.core.chi_square import chi_square_quantile, own_blocks, squared_distances
from fej_slam_ros.core.csam.maps import JointMap, LandmarkPair
from fej_slam_ros.core.geometry import Array, Flags, Indices

#: Probability that a correct pair is inside its gate, xi of Algorithm 2.
PAIR_PROBABILITY = 0.99
#: Probability that correct pairs together pass the joint test.
JOINT_PROBABILITY = 0.999


def match_landmarks(aligned: JointMap) -> JointMap:
    """Merge the duplicate landmarks of the minimum of aligned maps, Algorithm 2."""
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
    robots = [frozenset(robot for robot, _ in keys) for keys in matched.landmarks]
    # The usual case of many landmarks: of one robot, or with IDs that all robots share.
    if not robots or frozenset.intersection(*robots):
        return []
    points, may_match = matched.values.points, _are_apart(robots)
    if not may_match.any():
        return []
    P = matched.information().joint(points=range(len(points)))
    d2 = _squared_distances(points, P)
    inside = (d2 < chi_square_quantile(2, PAIR_PROBABILITY)) & may_match
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
    count, own = len(points), own_blocks(P)
    blocks = P.reshape(count, 2, count, 2).transpose(0, 2, 1, 3)
    S = own[:, None] + own - blocks - blocks.transpose(0, 1, 3, 2)
    # S of a landmark and itself is zero; such pairs are not used.
    S[np.diag_indices(count)] = np.eye(2)
    r = points[:, None] - points
    return squared_distances(r.reshape(-1, 2), S.reshape(-1, 2, 2)).reshape(count, count)


def _are_apart(robots: Sequence[frozenset[str]]) -> Flags:
    """Return the pairs of landmarks (l, l) without a common one of their robots."""
    names = sorted(frozenset.union(*robots))
    is_of = np.array([[name in of_landmark for name in names] for of_landmark in robots], float)
    apart: Flags = is_of @ is_of.T == 0.0
    return apart


def _misfit(
    aligned: JointMap, matched: JointMap, pairs: Sequence[LandmarkPair]
) -> LandmarkPair | None:
    """Return the pair whose release lowers chi-square most, None if all pairs fit together."""
    increase = matched.chi_square - aligned.chi_square
    if increase <= chi_square_quantile(2 * len(pairs), JOINT_PROBABILITY):
        return None
    first, second = np.array(pairs).T
    points = aligned.values.points
    r = (points[first] - points[second]).ravel()
    landmarks, rows = np.unique([*first, *second], return_inverse=True)
    P = aligned.information().joint(points=landmarks.tolist())
    selected = np.eye(len(landmarks))[rows]
    H = np.kron(selected[:len(pairs)] - selected[len(pairs):], np.eye(2))
    S = cho_factor(H @ P @ H.T)
    # Without pair k chi-square r^T S^-1 r is less by e_k^T W_kk^-1 e_k, W = S^-1, e = W r.
    W, e = cho_solve(S, np.eye(len(r))), cho_solve(S, r).reshape(-1, 2)
    return pairs[int(np.argmax(squared_distances(e, own_blocks(W))))]
