# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The largest set of base nodes of which any two agree."""

from itertools import combinations

import numpy as np
import pytest

from fej_slam_ros.core.csam.agreement import largest_agreement
from fej_slam_ros.core.csam.base_node import BaseNode
from fej_slam_ros.core.csam.join_rules import DEFAULT_RULES

P = np.diag([0.04, 0.04, 0.0025])


def base_nodes(seed, places):
    """Return base nodes near poses that are given by number."""
    rng = np.random.default_rng(seed)
    means = [np.array([5.0 * place, -place, np.pi - 0.01]) for place in places]
    return [BaseNode(wrapped(mean + rng.multivariate_normal(np.zeros(3), P)), P) for mean in means]


def wrapped(pose):
    """Return a pose whose heading is in the range of headings, near to its end."""
    return np.array([*pose[:2], (pose[2] + np.pi) % (2.0 * np.pi) - np.pi])


@pytest.mark.parametrize(('places', 'expected'), [
    ([0, 0, 0], (0, 1, 2)), ([1, 0, 0], (1, 2)), ([0, 1, 0, 1, 1], (1, 3, 4)),
    ([0, 1, 2], (0,)), ([0, 1, 0, 1], (0, 2)), ([], ())])
def test_the_largest_set_is_found_and_of_equal_ones_the_first(places, expected):
    assert largest_agreement(base_nodes(1, places), DEFAULT_RULES) == expected


def test_correct_base_nodes_agree_as_often_as_the_rules_state():
    """Three pairs of each of 3,000 triples: at most 9,000 times 1e-4 disagree by chance."""
    sets = [largest_agreement(base_nodes(seed, [0, 0, 0]), DEFAULT_RULES) for seed in range(3000)]

    assert sum(len(chosen) < 3 for chosen in sets) <= 4


def test_any_two_of_a_set_agree():
    """A chain of base nodes, each near the next one only."""
    chain = [BaseNode(np.array([0.9 * k, 0.0, 0.0]), P) for k in range(5)]

    chosen = largest_agreement(chain, DEFAULT_RULES)

    limit = np.sqrt(0.08 * DEFAULT_RULES.limit(3))
    assert len(chosen) == 2
    assert all(0.9 * (k - i) < limit for i, k in combinations(chosen, 2))
