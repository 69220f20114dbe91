# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Large products are computed in pieces, and end early where they may."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core.ekf import matrix_product
from fej_slam_ros.core.ekf.matrix_product import product
from fej_slam_ros.core.pieces import between_pieces, EndedError


def test_a_large_product_is_that_of_its_rows(monkeypatch):
    A, B = np.random.default_rng(1).normal(size=(2, 9, 9))
    monkeypatch.setattr(matrix_product, 'PIECE_FLOPS', 2.0 * 9 * 9 * 2)
    served = []

    with between_pieces(lambda: served.append(1)):
        assert_allclose(product(A, B), A @ B, rtol=1e-14, atol=1e-14)

    assert len(served) == 4


def test_a_small_product_is_not_divided():
    A, B = np.random.default_rng(2).normal(size=(2, 50, 50))

    with between_pieces(lambda: pytest.fail('it was divided')):
        assert_allclose(product(A, B), A @ B, rtol=1e-14, atol=1e-13)


def test_a_product_ends_early_only_if_it_may(monkeypatch):
    monkeypatch.setattr(matrix_product, 'PIECE_FLOPS', 1.0)

    with between_pieces(lambda: None, lambda: True):
        assert_array_equal(product(np.eye(3), np.eye(3)), np.eye(3))
        with pytest.raises(EndedError):
            product(np.eye(3), np.eye(3), may_end=True)
