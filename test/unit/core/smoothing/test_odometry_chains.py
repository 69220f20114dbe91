# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Chains of odometry lead through poses without other measurements."""

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from fej_slam_ros.core.smoothing.odometry_chains import OdometryChains


@pytest.mark.parametrize(('increments', 'needed', 'eliminated'), [
    pytest.param([(0, 1), (1, 2), (2, 3)], [0], [1, 2], id='the last pose stays'),
    pytest.param([(0, 1), (1, 2), (2, 3)], [0, 2], [1], id='needed poses stay'),
    pytest.param([(0, 1), (2, 3), (3, 4)], [0, 2], [3], id='two robots'),
    pytest.param([(0, 1), (1, 2), (1, 3)], [0], [], id='a pose with three increments stays'),
    pytest.param([(1, 2), (0, 1), (2, 3)], [0], [], id='other orders stay'),
    pytest.param([(0, 1), (1, 2), (2, 3), (3, 0)], [0], [2, 3], id='a loop keeps two ends'),
    pytest.param([(0, 1), (2, 1), (2, 3)], [0], [], id='increments in both directions stay'),
])
def test_poses_with_one_increment_on_each_side_are_eliminated(increments, needed, eliminated):
    begins, ends = np.array(increments).T

    chains = OdometryChains.of(begins, ends, np.isin(np.arange(6), needed))

    assert_array_equal(chains.eliminated, eliminated)
    begins, ends = chains.nodes
    assert not np.isin([*begins, *ends], eliminated).any()
    assert (begins != ends).all()
