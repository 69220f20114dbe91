# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A symmetric matrix in growing storage equals a plain array."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.linalg import block_diag

from fej_slam_ros.core.ekf.symmetric_matrix import GROWTH, SymmetricMatrix


def symmetric(n, seed=0):
    """Return a symmetric array (n, n)."""
    A = np.random.default_rng(seed).normal(size=(n, n))
    return A + A.T


def stored(P):
    """Return the matrix of a symmetric array."""
    matrix = SymmetricMatrix()
    matrix.append(len(P))
    matrix.lower[:len(P), :len(P)] = np.tril(P)
    return matrix


def elements(matrix):
    """Return the whole matrix (n, n)."""
    every = np.arange(matrix.dimension)
    return matrix.at(every[:, None], every)


@pytest.mark.parametrize('n', [0, 1, 5, 3 * GROWTH])
def test_a_packed_matrix_is_restored_with_its_capacity(n):
    matrix = stored(symmetric(n))

    restored = SymmetricMatrix(*matrix.packed())

    assert restored.dimension == n
    assert_array_equal(restored.lower, matrix.lower)


def test_a_copy_has_the_capacity_on_which_rounding_depends_and_changes_with_no_other():
    P = symmetric(3 * GROWTH)
    matrix = stored(P)

    copied = matrix.copy()
    matrix.remove(np.array([1, 4]))

    assert_array_equal(copied.lower, stored(P).lower)


CHANGES = {
    'columns are replaced': lambda matrix: matrix.replace_columns(
        np.array([1, 4]), stored(symmetric(6, seed=1)).columns(np.array([1, 4]))),
    'a product is subtracted': lambda matrix: matrix.subtract_product(
        np.asfortranarray(np.eye(GROWTH, 2))),
    'rows are deleted': lambda matrix: matrix.remove(np.array([0, 3])),
    'rows are appended': lambda matrix: matrix.append(GROWTH)}


@pytest.mark.parametrize('change', CHANGES.values(), ids=CHANGES)
def test_changes_are_those_of_the_elements_after_all_propagations(change):
    rng = np.random.default_rng(3)
    P, Phi, N = symmetric(6), rng.normal(size=(2, 2)), symmetric(2, seed=4)
    A = block_diag(1.0, Phi, np.eye(3))
    matrix, propagated = stored(P), stored(A @ P @ A.T + block_diag(0.0, N, np.zeros((3, 3))))

    matrix.propagate(1, Phi, N)
    for each in (matrix, propagated):
        change(each)

    assert_allclose(elements(matrix), elements(propagated), atol=1e-12)


def test_elements_and_columns_include_both_triangles():
    P = symmetric(7)
    matrix = stored(P)

    assert_array_equal(elements(matrix), P)
    columns = matrix.columns(np.array([4, 1]))
    assert_array_equal(columns[:7], P[:, [4, 1]])
    assert not columns[7:].any()


def test_replaced_columns_also_replace_their_rows():
    P, Q = symmetric(6), symmetric(6, seed=1)
    matrix, indices = stored(P), np.array([1, 4])

    matrix.replace_columns(indices, stored(Q).columns(indices))

    P[:, indices], P[indices] = Q[:, indices], Q[indices]
    assert_array_equal(elements(matrix), P)


def test_a_product_is_subtracted_in_place():
    P, matrix = symmetric(6), stored(symmetric(6))
    W = np.zeros((len(matrix.lower), 3), order='F')
    W[:6] = np.random.default_rng(2).normal(size=(6, 3))

    matrix.subtract_product(W)

    assert_allclose(elements(matrix), P - W[:6] @ W[:6].T, atol=1e-12)


def test_appended_rows_are_zero_beyond_the_capacity():
    P, matrix = symmetric(GROWTH), stored(symmetric(GROWTH))

    assert matrix.append(3) == GROWTH

    expected = np.zeros((GROWTH + 3, GROWTH + 3))
    expected[:GROWTH, :GROWTH] = P
    assert_array_equal(elements(matrix), expected)


def test_deleted_rows_leave_zeros_behind():
    P, matrix = symmetric(6), stored(symmetric(6))
    kept = np.array([0, 2, 5])

    matrix.remove(np.array([1, 3, 4]))

    assert_array_equal(elements(matrix), P[np.ix_(kept, kept)])
    matrix.append(3)
    assert not elements(matrix)[3:].any()


@pytest.mark.parametrize('sizes', [[], [2], [2] * 7, [2] * 500, [3, 2] * 90, [40, 2, 2]])
def test_reserved_storage_is_that_to_which_rows_would_grow_it(sizes):
    P = symmetric(21)
    reserved, grown = stored(P), stored(P)

    reserved.reserve(sizes)
    capacity = len(reserved.lower)
    for size in sizes:
        assert reserved.append(size) == grown.append(size)

    assert len(reserved.lower) == len(grown.lower) == capacity
    assert_array_equal(reserved.lower, grown.lower)
