# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks of a sparse inverse are those of the dense inverse."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.linalg import ldl
from scipy.sparse import csc_array

from fej_slam_ros.core.smoothing.inverse_blocks import inverse_blocks


@pytest.mark.parametrize('seed', range(5))
def test_all_blocks_are_those_of_the_dense_inverse(seed):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 4, 25)
    firsts = np.cumsum(sizes) - sizes
    dense = np.zeros((sizes.sum(), sizes.sum()))
    # Two nodes are linked with a probability of a tenth; node 7 to none.
    for a in range(25):
        for b in range(a):
            if rng.uniform() < 0.1 and 7 not in (a, b):
                block = rng.normal(size=(sizes[a], sizes[b]))
                dense[firsts[a]:][:sizes[a], firsts[b]:][:, :sizes[b]] = block
        dense[firsts[a]:][:sizes[a], firsts[a]:][:, :sizes[a]] = np.eye(sizes[a]) * 20.0
    dense = np.tril(dense) + np.tril(dense, -1).T
    L, D, order = ldl(dense, lower=True)
    assert (order == np.arange(len(dense))).all()
    inverse = np.linalg.inv(dense)

    found = list(inverse_blocks(csc_array(L), np.diag(D), csc_array(dense), sizes))

    assert sorted(k for group in found for k in group.blocks) == list(range(25))
    for group in found:
        for k, Z, rows, Z_linked in zip(*group):
            own = np.arange(firsts[k], firsts[k] + sizes[k])
            assert_allclose(Z, inverse[own[:, None], own], atol=1e-14)
            assert_allclose(Z_linked, inverse[rows[:, None], own], atol=1e-14)
            assert {*np.flatnonzero(dense[own[-1] + 1:, own].any(axis=1)) + own[-1] + 1} <= {*rows}


def test_an_entry_of_the_factor_that_happens_to_be_zero_is_no_gap():
    # L[2, 1] = 0.5 - 1.0 * 1.0 / 2.0 = 0.
    dense = np.array([[2.0, 1.0, 1.0, 0.0], [1.0, 2.0, 0.5, 0.0], [1.0, 0.5, 3.0, 1.0],
                      [0.0, 0.0, 1.0, 4.0]])
    L, D, _ = ldl(dense, lower=True)
    assert L[2, 1] == 0.0

    groups = inverse_blocks(csc_array(L), np.diag(D), csc_array(dense), np.ones(4, np.intp))

    inverse = np.linalg.inv(dense)
    for group in groups:
        assert_allclose(group.Z[:, 0, 0], np.diag(inverse)[group.blocks], rtol=1e-14)
