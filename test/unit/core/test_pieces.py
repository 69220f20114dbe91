# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long computations pause, and end early where they may."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from fej_slam_ros.core import pieces
from fej_slam_ros.core.pieces import between_pieces, EndedError, must_end, pause, product, ranges


def test_ranges_cover_all_items_with_a_pause_between_them():
    served = []

    with between_pieces(lambda: served.append(1)):
        covered = [np.arange(10)[part].tolist() for part in ranges(10, 4.9)]

    assert covered == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]
    assert len(served) == 2


def test_a_large_product_is_that_of_its_rows(monkeypatch):
    A, B = np.random.default_rng(1).normal(size=(2, 9, 9))
    monkeypatch.setattr(pieces, 'PIECE_FLOPS', 2.0 * 9 * 9 * 2)
    served = []

    with between_pieces(lambda: served.append(1)):
        assert_allclose(product(A, B), A @ B, rtol=1e-14, atol=1e-14)

    assert len(served) == 4


def test_a_small_product_is_not_divided():
    A, B = np.random.default_rng(2).normal(size=(2, 50, 50))

    with between_pieces(lambda: pytest.fail('it was divided')):
        assert_array_equal(product(A, B), A @ B)


def test_a_product_ends_early_only_if_it_may(monkeypatch):
    monkeypatch.setattr(pieces, 'PIECE_FLOPS', 1.0)

    with between_pieces(lambda: None, lambda: True):
        assert_array_equal(product(np.eye(3), np.eye(3)), np.eye(3))
        with pytest.raises(EndedError):
            product(np.eye(3), np.eye(3), may_end=True)


def test_the_functions_of_the_innermost_context_are_called():
    assert not pause()
    with between_pieces(lambda: pytest.fail('outer'), lambda: False):
        with between_pieces(lambda: None, lambda: True):
            assert pause()
        assert not must_end()
