# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Merging of duplicate landmarks.

A landmark without ID is started a second time where a robot returns with an error larger than its
covariance says, and where frames are joined that both have mapped it.
"""

from collections.abc import Iterable, Sequence
import math

import numpy as np

from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.state import Landmark, position_indices
from fej_slam_ros.core.pieces import pause
from fej_slam_ros.core.records import NO_ID

#: Likelihood ratio of one landmark to two beyond which both are merged.
MIN_LIKELIHOOD_RATIO = 10.0


def merge_duplicates(
    filter_: Filter, candidates: Iterable[Landmark], observed_together: Sequence[Landmark] = ()
) -> dict[int, int]:
    """
    Merge each candidate with its nearest neighbour where both are one landmark.

    The landmarks `observed_together` are those of one scan, and therefore all distinct. The state
    has a robot. Returns the ID of the remaining landmark by that of each merged one.

    """
    state = filter_.state
    # Of a robot's own ID only that robot's observations can be.
    confirmed = [f for f in state.confirmed_landmarks() if not f.key[0]]
    positions = state.estimates_of(position_indices(confirmed))
    merged: dict[Landmark, Landmark] = {}
    for landmark in candidates:
        if landmark.key[1] >= NO_ID or landmark not in confirmed or len(confirmed) < 3:
            continue
        distances = np.hypot(*(positions - state.estimate(landmark)).T)
        _, nearest, second = np.argpartition(distances, (0, 1, 2))[:3]
        other = confirmed[nearest]
        if {landmark, other} <= {*observed_together}:
            landmark.distinct.add(other.key)
            other.distinct.add(landmark.key)
        elif not _are_distinct(landmark, other) and _are_one(
            filter_, landmark, other, float(distances[second])
        ):
            kept, duplicate = sorted((landmark, other), key=lambda f: -f.key[1])
            kept.absorb(duplicate)
            filter_.equate(kept, duplicate)
            merged[duplicate] = kept
            confirmed.remove(duplicate)
            positions = state.estimates_of(position_indices(confirmed))
            pause()
    state.remove_all([*merged])
    return {duplicate.key[1]: kept.key[1] for duplicate, kept in merged.items()}


def _are_distinct(a: Landmark, b: Landmark) -> bool:
    """Return whether one scan observed both, or landmarks merged into them."""
    return a.key in b.distinct or b.key in a.distinct


def _are_one(filter_: Filter, a: Landmark, b: Landmark, spacing: float) -> bool:
    """
    Return whether two landmarks are one, by the density of their difference d.

    For one landmark it is N(d; 0, S), for two it is 1 / (pi spacing^2).

    """
    d, (columns, (H,)) = filter_.landmark_difference(a, b)
    P, = filter_.state.covariance.blocks(columns)
    S = H @ P @ H.T
    d2 = float(d @ np.linalg.solve(S, d))
    ratio = math.exp(-0.5 * d2) * spacing**2 / (2.0 * math.sqrt(np.linalg.det(S)))
    return ratio > MIN_LIKELIHOOD_RATIO
