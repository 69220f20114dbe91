# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Landmarks that are found to be one.

A landmark gets a second number where a robot comes back by a way whose error is larger than it
knows, and where frames are joined in which nobody has numbered the landmarks.
"""

from collections.abc import Iterable, Sequence
import math

import numpy as np

from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.state import JointState, Landmark, position_indices
from fej_slam_ros.core.geometry import Array
from fej_slam_ros.core.records import NO_ID

#: Landmarks are one where that is so much likelier than that they are two.
ONE_WHERE_LIKELIER = 10.0


def merge_duplicates(
    group: Filter, among: Iterable[Landmark], together: Sequence[Landmark] = ()
) -> int:
    """
    Let landmarks be one that are found to be; return how many are gone.

    Parameters
    ----------
    group : whose landmarks they are
    among : landmarks that are looked at, each with the one that is next to it
    together : landmarks that one scan has shown, so that no two of them are one

    """
    merged = 0
    settled, places = _map(group.state)
    for landmark in among:
        counts = landmark.tentative is None and landmark.key in group.state.landmarks
        if landmark.key[1] >= NO_ID or not counts or len(settled) < 3:
            continue
        away = np.hypot(*(places - group.state.estimate(landmark)).T)
        _, next_to_it, after = np.argpartition(away, (0, 1, 2))[:3]
        other = settled[next_to_it]
        if {landmark, other} <= {*together}:
            landmark.distinct.add(other.key)
            other.distinct.add(landmark.key)
        elif not _are_distinct(landmark, other) and _are_one(
            group.state, landmark, other, float(away[after])
        ):
            kept, gone = sorted((landmark, other), key=lambda f: -f.key[1])
            kept.distinct |= gone.distinct
            group.merge(kept, gone)
            settled, places = _map(group.state)
            merged += 1
    return merged


def _map(state: JointState) -> tuple[list[Landmark], Array]:
    """Return the landmarks that count, and where they are."""
    settled = state.confirmed_landmarks()
    return settled, state.estimates_of(position_indices(settled))


def _are_distinct(a: Landmark, b: Landmark) -> bool:
    """Return whether one scan has shown two landmarks, or what has become one of them."""
    return a.key in b.distinct or b.key in a.distinct


def _are_one(state: JointState, a: Landmark, b: Landmark, spacing: float) -> bool:
    """
    Return whether two landmarks are one, by the density of their difference d.

    Of one landmark it is N(d; 0, S), of two 1 / (pi spacing^2).

    """
    d: Array = state.estimate(a) - state.estimate(b)
    P = state.marginal([a, b])
    S = P[:2, :2] + P[2:, 2:] - P[:2, 2:] - P[2:, :2]
    d2 = float(d @ np.linalg.solve(S, d))
    likelier = math.exp(-0.5 * d2) * spacing**2 / (2.0 * math.sqrt(np.linalg.det(S)))
    return likelier > ONE_WHERE_LIKELIER
