# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Choice among several rendezvous of two maps: the largest set of which any two agree.

Each rendezvous alone gives a base node by Algorithm 1 of [Andersson]. Two of them agree if their
base nodes differ by no more than their covariances allow. The drift of the maps, an error of both,
is counted twice: wrong rendezvous are found, and inaccurate ones are left to the test against the
joint map. This is pairwise consistency maximisation (Mangelson et al., Pairwise
Consistent Measurement Set Maximization, ICRA 2018); of at most `MAX_COMPARED` all sets are tried.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from fej_slam_ros.core.csam.base_node import BaseNode
from fej_slam_ros.core.csam.join_rules import JoinRules
from fej_slam_ros.core.geometry import wrap_all

#: Number of rendezvous of which the largest set is found: each needs the information of both maps.
MAX_COMPARED = 5


def largest_agreement(base_nodes: Sequence[BaseNode], rules: JoinRules) -> tuple[int, ...]:
    """Return the indices of the largest set of which any two agree; of equal ones the first."""
    pairs = {
        (i, k) for i, k in combinations(range(len(base_nodes)), 2)
        if _agree(base_nodes[i], base_nodes[k], rules)}
    sets = (
        chosen for size in range(len(base_nodes), 0, -1)
        for chosen in combinations(range(len(base_nodes)), size)
        if pairs.issuperset(combinations(chosen, 2)))
    return next(sets, ())


def _agree(a: BaseNode, b: BaseNode, rules: JoinRules) -> bool:
    difference = b.pose - a.pose
    difference[2:] = wrap_all(difference[2:])
    # Also of base nodes that are exact in some direction.
    information = np.linalg.pinv(a.P + b.P, hermitian=True)
    return float(difference @ information @ difference) <= rules.limit(3)
