# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled kernel computes what numpy does, and decides the same."""

import copy
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.linalg import block_diag

from fej_slam_ros.core.ekf import numpy_kernel
from fej_slam_ros.core.ekf.kernel import KERNEL, load, VARIABLE
from fej_slam_ros.core.records import Observation, Scan
from fej_slam_ros.errors import UsageError
from helpers.core import SmallTeam

pytestmark = pytest.mark.needs('fej_slam_ros.core.ekf._kernel')

#: Sums of a few hundred products of numbers near 1 differ by the order in which they are added.
TOLERANCE = {'rtol': 1e-12, 'atol': 1e-12}


@pytest.fixture
def compiled():
    return load('compiled')


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def covariance(rng, n, capacity):
    """Return a positive definite matrix in a larger Fortran array, and its lower triangle."""
    A = rng.normal(size=(n, n))
    P = A @ A.T / n + np.eye(n)
    lower = np.zeros((capacity, capacity), order='F')
    lower[:n, :n] = np.tril(P)
    return P, lower


def observations(rng, n, m, d):
    """Return the states and the Jacobian of m observations of d states each."""
    return rng.integers(0, n, size=(m, d)), rng.normal(size=(m, 2, d))


def noise(rng, m):
    A = rng.normal(size=(m, 2, 2))
    return A @ A.transpose(0, 2, 1) + np.eye(2)


def read_only(matrix):
    matrix.flags.writeable = False
    return matrix


def assert_equal_results(a, b):
    for one, other in zip(a, b, strict=True):
        assert_allclose(one, other, **TOLERANCE)


@pytest.mark.parametrize('name', ['fortran', 'Numpy'])
def test_an_unknown_kernel_is_refused_with_those_that_are_installed(name):
    with pytest.raises(UsageError, match=f'{VARIABLE} is {name}; installed here: compiled, numpy'):
        load(name)


def test_the_kernel_in_use_is_the_compiled_one_where_it_was_built():
    assert os.environ.get(VARIABLE, 'compiled') == KERNEL.NAME


@pytest.mark.parametrize('turn', [0.1, 3.0, -3.1])
def test_motions_are_equal(compiled, rng, turn):
    x, u, Q = np.array([1.0, -2.0, turn]), np.array([0.3, 0.1, turn]), rng.normal(size=(3, 3))

    assert_equal_results(compiled.moved(x, u, Q), numpy_kernel.moved(x, u, Q))


@pytest.mark.parametrize('d', [2, 3])
@pytest.mark.parametrize('is_first', [True, False])
def test_propagations_are_equal(compiled, rng, d, is_first):
    before, block, Phi, N = rng.normal(size=(4, d, d))
    arguments = None if is_first else before, block, Phi, N

    assert_equal_results(compiled.propagated(*arguments), numpy_kernel.propagated(*arguments))


def test_transitions_are_equal(compiled, rng):
    x, x_next = rng.normal(size=(2, 3))

    assert_array_equal(compiled.Phi(x, x_next), numpy_kernel.Phi(x, x_next))


@pytest.mark.parametrize('size', [2, 3])
def test_diagonal_blocks_are_symmetric_and_equal(compiled, rng, size):
    P, lower = covariance(rng, 20, 23)

    for one in (compiled, numpy_kernel):
        assert_array_equal(one.diagonal_block(lower, 4, size), P[4:4 + size, 4:4 + size])


# More rows below than the compiled kernel computes together.
@pytest.mark.parametrize('start', [0, 4, 147])
def test_cross_covariances_are_equal(compiled, rng, start):
    _, lower = covariance(rng, 150, 153)
    other, Phi, block = lower.copy('F'), *rng.normal(size=(2, 3, 3))

    for one, matrix in ((compiled, lower), (numpy_kernel, other)):
        one.settle(matrix, 150, start, Phi, block)

    assert_allclose(lower, other, **TOLERANCE)


@pytest.mark.parametrize('function', ['h', 'H'])
def test_observation_models_are_equal_for_views_of_joint_arrays(compiled, rng, function):
    x = rng.normal(scale=10.0, size=(7, 5))

    results = [getattr(one, function)(x[::2]) for one in (compiled, numpy_kernel)]

    assert_allclose(*results, **TOLERANCE)


def test_stacked_observations_are_equal_whatever_the_layout_and_type_of_their_arrays(
    compiled, rng,
):
    observers, observed = map(list, rng.integers(0, 100, size=(2, 3)))
    z = [rng.normal(size=4)[::2], np.ones(2, int), rng.normal(size=2)]
    R = [rng.normal(size=(2, 2)).T, np.eye(2, dtype=int), np.eye(2, dtype=np.float32)]

    results = [one.stacked(observers, observed, z, R) for one in (compiled, numpy_kernel)]

    assert results[0][0].tolist() == [
        [a, a + 1, a + 2, b, b + 1] for a, b in zip(observers, observed)]
    for one, other, expected in zip(*results, (None, z, R), strict=True):
        assert_array_equal(one, other)
        assert one.dtype == other.dtype
        assert expected is None or np.array_equal(one, expected)


@pytest.mark.parametrize(('given', 'error', 'message'), [
    (([0], [3], [np.zeros(3)], [np.eye(2)]), ValueError, 'of 2 numbers'),
    (([0], [3], [np.zeros(2)], [np.eye(3)]), ValueError, 'of 4 numbers'),
    (([0.5], [3], [np.zeros(2)], [np.eye(2)]), TypeError, 'int'),
    (([2 ** 70], [3], [np.zeros(2)], [np.eye(2)]), OverflowError, 'int'),
    (([-1], [3], [np.zeros(2)], [np.eye(2)]), ValueError, 'no index'),
    (([0], [sys.maxsize - 1], [np.zeros(2)], [np.eye(2)]), ValueError, 'no index'),
    (([0], [3], [np.zeros(2)], []), TypeError, 'four lists'),
    (([0], [3], np.zeros((1, 2)), [np.eye(2)]), TypeError, 'four lists'),
    (([0], [3]), TypeError, 'four lists')])
def test_observations_that_cannot_be_stacked_are_refused(compiled, given, error, message):
    with pytest.raises(error, match=message):
        compiled.stacked(*given)


@pytest.mark.parametrize(('n', 'm', 'd'), [(8, 1, 5), (50, 2, 5), (50, 30, 5), (90, 9, 7)])
def test_updates_are_equal(compiled, rng, n, m, d):
    P, lower = covariance(rng, n, n + 3)
    (states, blocks), R, r = observations(rng, n, m, d), noise(rng, m), rng.normal(size=2 * m)
    H = np.zeros((2 * m, n))
    for i in range(m):
        np.add.at(H[2 * i:2 * i + 2].T, states[i], blocks[i].T)

    result = []
    for one in (compiled, numpy_kernel):
        matrix = lower.copy('F')
        seen, sparse, S, own = one.project(matrix, n, states, blocks, R)
        dx, y, W, log_det = one.correction(seen, sparse, S.copy(), r, n)
        one.subtract_product(matrix, W, n)
        # The reference stores rows beyond n, which are zero.
        assert not seen[n:].any()
        assert not W[n:].any()
        result.append((seen[:n], sparse, np.tril(S), np.tril(own), dx, y, W[:n], log_det, matrix))

    assert_equal_results(*result)
    # By the textbook; the inverse of S loses digits.
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + block_diag(*R))
    assert_allclose(result[0][4], K @ r, rtol=1e-9, atol=1e-9)
    assert_allclose(np.tril(result[0][-1][:n, :n]), np.tril(P - K @ H @ P), rtol=1e-9, atol=1e-9)


def test_no_observations_have_no_innovation(compiled, rng):
    _, lower = covariance(rng, 8, 11)
    (states, blocks), R = observations(rng, 8, 0, 5), noise(rng, 0)

    for one in (compiled, numpy_kernel):
        seen, _, S, own = one.project(lower, 8, states, blocks, R)
        assert (seen.shape[1], S.shape, len(own)) == (0, (0, 0), 0)


# Numbers of rows below, at and beyond a vector of 8, a tile of 24 and the 480 rows that stay in
# the cache; ranks below and beyond the 128 columns that are subtracted together.
@pytest.mark.parametrize('n', [0, 1, 7, 8, 9, 31, 32, 33, 480, 481, 505])
@pytest.mark.parametrize('rank', [0, 1, 20, 129])
def test_a_product_is_subtracted_from_the_lower_triangle_and_nothing_else_changes(
    compiled, rng, n, rank
):
    lower, W = np.asfortranarray(rng.normal(size=(n + 3, n + 3))), rng.normal(size=(n + 2, rank))
    changed, expected = lower.copy('F'), lower.copy()

    compiled.subtract_product(changed, np.asfortranarray(W), n)

    expected[:n, :n] -= np.tril(W[:n] @ W[:n].T)
    # 129 products of normal numbers, of which some are 4: sums of up to 300.
    assert_allclose(np.tril(changed[:n, :n]), np.tril(expected[:n, :n]), rtol=0.0, atol=1e-12)
    outside = np.ones(lower.shape, bool)
    outside[np.tril_indices(n)] = False
    assert_array_equal(changed[outside], lower[outside])


@pytest.mark.parametrize(('m', 'k', 'n'), [
    (3, 2, 4), (4, 2, 3), (0, 2, 3), (3, 0, 4), (9, 130, 500), (500, 130, 9), (40, 40, 40)])
def test_products_are_equal_in_any_layout(compiled, rng, m, k, n):
    A, B = rng.normal(size=(m, k)), rng.normal(size=(k, 2 * n))[:, ::2]

    for left in (A, np.asfortranarray(A)):
        for right in (B, B.copy(), B.copy('F')):
            before = left.copy(), right.copy()
            assert_allclose(compiled.product(left, right), A @ B, rtol=0.0, atol=1e-12)
            assert_array_equal(left, before[0])
            assert_array_equal(right, before[1])


# Parts of columns above the diagonal that end within, at and beyond a line of the cache.
@pytest.mark.parametrize('indices', [[0, 7, 8, 9], [19, 3, 3], []])
def test_full_columns_are_equal(compiled, rng, indices):
    P, lower = covariance(rng, 20, 23)

    for one in (compiled, numpy_kernel):
        full = one.columns(lower, np.array(indices, np.intp))
        assert full.flags.f_contiguous
        assert_array_equal(full[:20], P[:, indices])
        assert not full[20:].any()


@pytest.mark.parametrize('indices', [[0, 7, 8, 9], [19, 3], []])
def test_replaced_columns_are_those_given_and_all_others_stay(compiled, rng, indices):
    P, lower = covariance(rng, 20, 23)
    other, _ = covariance(rng, 20, 23)
    full = np.zeros((23, len(indices)), order='F')
    full[:20] = other[:, indices]
    expected = P.copy()
    expected[:, indices], expected[indices] = other[:, indices], other[indices]

    for one in (compiled, numpy_kernel):
        replaced = lower.copy('F')
        one.replace_columns(replaced, np.array(indices, np.intp), full)
        assert_array_equal(replaced[:20, :20], np.tril(expected))
        assert not replaced[20:].any()


def test_columns_of_the_reference_are_updated_alike(compiled, rng):
    # Large columns are read by the reference, in pieces.
    _, lower = covariance(rng, 8, 11)
    (states, blocks), R, r = observations(rng, 8, 2, 5), noise(rng, 2), rng.normal(size=4)
    _, sparse, S, _ = compiled.project(lower, 8, states, blocks, R)
    columns = [one.project(lower, 8, states, blocks, R)[0] for one in (compiled, numpy_kernel)]

    results = [compiled.correction(P, sparse, S.copy(), r, 8) for P in columns]

    assert [len(P) for P in columns] == [8, 11]
    for one, other in zip(*results, strict=True):
        assert_array_equal(one, other)


def test_a_covariance_that_is_not_positive_definite_is_refused_by_both(compiled):
    P, H, S = np.eye(3, 2, order='F'), np.eye(2, order='F'), np.diag([1.0, -1.0])

    for one in (compiled, numpy_kernel):
        with pytest.raises(ArithmeticError, match='not positive definite at 2'):
            one.correction(P, H.copy('F'), S.copy(), np.zeros(2), 3)


def test_distances_are_equal_for_views_of_a_joint_covariance(compiled, rng):
    r, S = rng.normal(size=(4, 2)), noise(rng, 4)
    of_joint = np.zeros((4, 4, 2, 2))
    of_joint[:, 1] = S

    assert_allclose(
        compiled.squared_distances(r, of_joint[:, 1]), numpy_kernel.squared_distances(r, S),
        **TOLERANCE)


def test_corrections_wrap_the_same_headings(compiled, rng):
    x, dx = rng.normal(scale=3.0, size=(2, 12))
    headings = np.arange(12).reshape(4, 3)[:, 2]  # a view of every third
    x[headings[:2]], dx[headings[:2]] = [np.pi, -np.pi], 0.0

    corrected = compiled.retracted(x, dx, headings)

    assert corrected[headings[:2]].tolist() == [np.pi, np.pi]
    assert_array_equal(corrected, numpy_kernel.retracted(x, dx, headings))


#: Lines of a program that prints the kernel and the estimate after a run of two robots.
RUN = [
    'from fej_slam_ros.core.ekf.kernel import KERNEL',
    'from helpers.core import SmallTeam',
    'team = SmallTeam(seed=3, landmarks=12)',
    "filter_ = team.start('{kind}')",
    'for stamp in range(1, 60):',
    '    team.step(filter_, stamp, team.names, team.names)',
    'x, P = filter_.state.x_hat, filter_.state.marginal(filter_.state.variables())',
    'print(KERNEL.NAME)',
    'print(x.tolist())',
    'print(P.ravel().tolist())',
]


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_a_run_ends_with_the_same_estimate_whichever_kernel_is_chosen(kind):
    results = {}
    for name in ('compiled', 'numpy'):
        ended = subprocess.run(
            [sys.executable, '-c', '\n'.join(RUN).format(kind=kind)], text=True, check=True,
            capture_output=True, cwd=Path(__file__).parents[3],
            env={**os.environ, VARIABLE: name})
        used, *numbers = ended.stdout.splitlines()
        assert used == name
        results[name] = [np.array(eval(line)) for line in numbers]  # noqa: S307

    # Each step adds rounding errors of 1e-16 of numbers up to 100 m.
    for one, other in zip(results['compiled'], results['numpy'], strict=True):
        assert_allclose(one, other, rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize('lower', [
    np.eye(4)[:3, :3], np.eye(4, dtype=np.float32, order='F'), read_only(np.eye(4, order='F'))])
def test_a_matrix_that_cannot_be_changed_in_place_is_refused(compiled, lower):
    with pytest.raises(TypeError, match='argument 0 is no Fortran array of double'):
        compiled.subtract_product(lower, np.zeros((len(lower), 2)), len(lower))


def test_a_product_of_another_size_and_numbers_out_of_range_are_refused(compiled):
    lower = np.eye(4, order='F')

    with pytest.raises(ValueError, match='do not fit'):
        compiled.subtract_product(lower, np.zeros((3, 2), order='F'), 4)
    with pytest.raises(TypeError, match='integer'):
        compiled.diagonal_block(lower, 1.5, 2)
    assert_array_equal(compiled.diagonal_block(lower, np.int64(1), 2), np.eye(2))


POSE, SQUARE, FULL = np.zeros(3), np.eye(3), np.eye(4, order='F')
STATES, JACOBIAN, R = np.array([[0, 1, 2, 2, 3]]), np.zeros((1, 2, 5)), np.zeros((1, 2, 2))


@pytest.mark.parametrize(('function', 'arguments'), [
    ('moved', (POSE, np.zeros(2), SQUARE)), ('moved', (POSE, POSE, np.diag(SQUARE))),
    ('Phi', (POSE, np.zeros(2))), ('Phi', (POSE, SQUARE)),
    ('propagated', (None, SQUARE, np.eye(2), SQUARE)), ('propagated', (None, *[np.eye(4)] * 3)),
    ('propagated', (np.eye(2), SQUARE, SQUARE, SQUARE)),
    ('diagonal_block', (FULL, 2, 3)), ('diagonal_block', (FULL, -1, 2)),
    ('diagonal_block', (FULL, 0, -1)), ('settle', (FULL, 5, 0, SQUARE, SQUARE)),
    ('settle', (FULL, 4, 2, SQUARE, SQUARE)), ('settle', (FULL, 4, -1, SQUARE, SQUARE)),
    ('settle', (FULL, 4, 0, SQUARE, np.eye(2))), ('h', (np.zeros((2, 3)),)), ('h', (POSE,)),
    ('H', (np.zeros((2, 3)),)), ('project', (FULL, 4, STATES + 1, JACOBIAN, R)),
    ('project', (FULL, 4, -STATES, JACOBIAN, R)), ('project', (FULL, 5, STATES, JACOBIAN, R)),
    ('project', (FULL, 4, STATES, JACOBIAN[..., :4], R)),
    ('project', (FULL, 4, STATES, JACOBIAN, R[:, 0])),
    ('project', (FULL, 4, STATES[0], JACOBIAN, R)),
    ('squared_distances', (np.zeros((2, 2)), R)), ('squared_distances', (np.zeros(2), R)),
    ('correction', (FULL, np.zeros((2, 3)), np.eye(2), np.zeros(2), 4)),
    ('correction', (FULL, np.zeros((2, 4)), np.eye(3), np.zeros(2), 4)),
    ('correction', (FULL, np.zeros((2, 4)), np.eye(2), np.zeros(2), 5)),
    ('product', (SQUARE, np.eye(4))), ('product', (POSE, SQUARE)),
    ('subtract_product', (FULL, np.zeros((4, 2), order='F'), 5)),
    ('subtract_product', (FULL, np.zeros((4, 2), order='F'), 2 ** 32)),
    ('correction', (FULL, np.zeros((2, 4)), np.eye(2), np.zeros(2), 2 ** 32)),
    ('columns', (FULL[:, :3], [0])), ('columns', (FULL, [4])), ('columns', (FULL, [-1])),
    ('replace_columns', (FULL, [0], np.zeros((3, 1), order='F'))),
    ('replace_columns', (FULL, [0], np.zeros((4, 2), order='F'))),
    ('replace_columns', (FULL, [4], np.zeros((4, 1), order='F'))),
    ('retracted', (POSE, np.zeros(2), [2])), ('retracted', (POSE, POSE, [3])),
    ('retracted', (POSE, POSE, [-1]))])
def test_arrays_of_other_shapes_are_refused(compiled, function, arguments):
    # The compiled functions read memory without further checks.
    before = FULL.copy()

    with pytest.raises(ValueError, match=r'do not fit|must have'):
        getattr(compiled, function)(*arguments)

    assert_array_equal(FULL, before)


@pytest.mark.parametrize('dtype', [int, np.float32, np.dtype(float).newbyteorder()])
def test_arrays_of_other_numbers_or_byte_order_are_converted(compiled, rng, dtype):
    x, u = rng.normal(size=(2, 3))

    assert_equal_results(
        compiled.moved(x, u, np.eye(3, dtype=dtype)), numpy_kernel.moved(x, u, np.eye(3)))


def test_whole_numbers_in_an_observation_are_used():
    team = SmallTeam(seed=3, landmarks=4)
    filter_ = team.start('fej')
    team.step(filter_, 1, team.names, team.names)
    other = copy.deepcopy(filter_)
    (first, *_) = filter_.state.landmarks
    z, R = np.array([1, 2]), np.array([[4, 0], [0, 4]])

    for one, kind in ((filter_, int), (other, float)):
        one.step([], [Scan('r1', 1, (Observation(first[1], z.astype(kind), R.astype(kind)),))])

    assert_array_equal(filter_.state.x_hat, other.state.x_hat)
