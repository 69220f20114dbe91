# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bookkeeping of the joint covariance against matrices written out in full."""

from copy import copy

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from scipy.linalg import block_diag

from fej_slam_ros.core.ekf.covariance import (
    Covariance, joint_indices, SparseRows, Transport)
from fej_slam_ros.core.ekf.joint_covariance import lower_rows
from helpers.core import dense, random_covariance

#: Sizes of the variables: few, some beyond one growth of the storage, and many growths.
TEAMS = {'small': (3, 2), 'beyond 64 states': (3, 3, *[2] * 35), 'large': (3, *[2] * 130)}


class Textbook:
    """The same operations on a dense P, as a textbook writes them."""

    def __init__(self, P):
        self.P = P

    def augment(self, parent, F, N):
        A = np.vstack([np.eye(len(self.P)), np.zeros((len(F), len(self.P)))])
        A[len(self.P):, parent.indices] = F
        noise = block_diag(np.zeros_like(self.P), N)
        self.P = A @ self.P @ A.T + noise

    def propagate(self, slot, Phi, N):
        A, noise = np.eye(len(self.P)), np.zeros_like(self.P)
        A[np.ix_(slot.indices, slot.indices)] = Phi
        noise[np.ix_(slot.indices, slot.indices)] = N
        self.P = A @ self.P @ A.T + noise

    def update(self, H, R, r):
        S = H @ self.P @ H.T + R
        K = self.P @ H.T @ np.linalg.inv(S)
        self.P = self.P - K @ S @ K.T
        return K @ r, r @ np.linalg.inv(S) @ r


def both(rng, team):
    """Return a covariance, its slots and a dense copy, with random correlations."""
    P = random_covariance(rng, sum(TEAMS[team]))
    covariance = Covariance()
    slots = covariance.insert(P).split(TEAMS[team])
    return covariance, slots, Textbook(P)


def random_observations(rng, slots, count):
    """Return observations of variables by the first one, sparse and dense, with their noise."""
    observed = rng.integers(1, len(slots), count)
    columns = np.array([[*slots[0].indices, *slots[i].indices[:2]] for i in observed])
    sparse = SparseRows(columns, rng.normal(size=(count, 2, 5)))
    R = np.array([random_covariance(rng, 2) for _ in range(count)])
    return sparse, dense(sparse, slots[-1].stop), R


def random_transport(rng, n):
    """Return a transport by two of n states, sparse and dense."""
    columns, V, A = np.array([2, n - 1]), rng.normal(size=(n, 2)), np.eye(n)
    A[:, columns] += V
    return Transport(columns, V, np.zeros(len(V)), lambda _: None), A


def rows_after_a_transport(rng, slots, count):
    """Return rows of which each names columns twice, sparse and dense, and their noise."""
    sparse, H, R = random_observations(rng, slots, count)
    transport, A = random_transport(rng, slots[-1].stop)
    return sparse.after(transport), H @ A, R


@pytest.fixture(params=TEAMS)
def team(request):
    return request.param


def test_marginals_are_blocks_in_the_requested_order(team):
    covariance, slots, book = both(np.random.default_rng(1), team)
    chosen, other = [slots[-1], slots[0]], slots[:-1]

    i, j = (np.concatenate([slot.indices for slot in some]) for some in (chosen, other))

    assert_array_equal(covariance.marginal(chosen), book.P[np.ix_(i, i)])
    assert_array_equal(covariance.matrix.at(i[:, None], j), book.P[np.ix_(i, j)])


def test_an_inserted_variable_is_independent_of_all_others(team):
    rng = np.random.default_rng(2)
    covariance, slots, book = both(rng, team)
    P = random_covariance(rng, 3)

    slot = covariance.insert(P)

    assert_array_equal(covariance.marginal([*slots, slot]), block_diag(book.P, P))


def test_variables_may_be_inserted_jointly_or_one_by_one():
    P = [random_covariance(np.random.default_rng(3), 3) for _ in range(30)]
    one_by_one, joint = Covariance(), Covariance()

    slots = [one_by_one.insert(block) for block in P]
    joint_slots = joint.insert(block_diag(*P)).split([3] * 30)

    assert_array_equal(one_by_one.marginal(slots), joint.marginal(joint_slots))


def test_augment_is_a_congruence(team):
    rng = np.random.default_rng(4)
    covariance, slots, book = both(rng, team)
    for _ in range(35):  # beyond the next growth of the storage
        F, N = rng.normal(size=(2, 3)), random_covariance(rng, 2)
        slots.append(covariance.augment(slots[0], F, N))
        book.augment(slots[0], F, N)
    # Rounding of a few sums of order 10.
    assert_allclose(covariance.marginal(slots), book.P, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize('index', [0, 1, -1])
def test_propagate_is_a_congruence(team, index):
    rng = np.random.default_rng(5)
    covariance, slots, book = both(rng, team)
    size = slots[index].size
    Phi, N = rng.normal(size=(size, size)), random_covariance(rng, size)

    covariance.propagate(slots[index], Phi, N)
    book.propagate(slots[index], Phi, N)

    assert_allclose(covariance.marginal(slots), book.P, atol=1e-13)


def propagate_in_turn(covariances, slots, rng):
    """Propagate the first and the last variable three times in turn."""
    for slot in 3 * [slots[0], slots[-1]]:
        Phi, N = rng.normal(size=(slot.size, slot.size)), random_covariance(rng, slot.size)
        for covariance in covariances:
            covariance.propagate(slot, Phi, N)


READERS = {
    'marginal': lambda P, slots: P.marginal(slots),
    'blocks': lambda P, slots: P.blocks(joint_indices(slots)[None])[0],
    'rows': lambda P, slots: np.array([
        np.pad(row, (0, slots[-1].stop - len(row))) for row in lower_rows(P, slots)]),
    'one by one': lambda P, slots: np.block([
        [P.marginal([a]) if a is b else P.matrix.at(a.indices[:, None], b.indices) for b in slots]
        for a in slots]),
    'copy': lambda P, slots: np.tril(copy(P).matrix.lower)[:slots[-1].stop, :slots[-1].stop],
}


@pytest.mark.parametrize('read', READERS.values(), ids=READERS)
def test_all_that_is_read_contains_all_propagations(team, read):
    rng = np.random.default_rng(8)
    covariance, slots, book = both(rng, team)
    propagate_in_turn((covariance, book), slots, rng)

    P = read(covariance, slots)

    # Products of nine random matrices are summed in another order.
    assert_allclose(np.tril(P), np.tril(book.P), atol=1e-13 * np.abs(book.P).max())


def test_reading_between_propagations_changes_no_bit(team):
    ends = []
    for readers in ({}, READERS):
        rng = np.random.default_rng(9)
        covariance, slots, _ = both(rng, team)
        propagate_in_turn([covariance], slots, rng)
        for read in readers.values():
            read(covariance, slots)
        propagate_in_turn([covariance], slots, rng)
        ends.append(np.tril(covariance.matrix.lower))

    assert_array_equal(*ends)


@pytest.mark.parametrize('rows', [random_observations, rows_after_a_transport])
@pytest.mark.parametrize('count', [1, 2, 9])
def test_an_update_equals_the_textbook_update(team, count, rows):
    rng = np.random.default_rng(6)
    covariance, slots, book = both(rng, team)
    sparse, H, R = rows(rng, slots, count)
    r = rng.normal(size=2 * count)

    P_before, prior = book.P, covariance.project(sparse, R)
    correction = covariance.correction(prior, r)
    covariance.condition(correction)
    expected_dx, nis = book.update(H, block_diag(*R), r)

    # The noise of an observation is up to 1e3 times smaller than S.
    assert_allclose(prior.S, H @ P_before @ H.T + block_diag(*R), atol=1e-12)
    assert_allclose(correction.dx, expected_dx, atol=1e-10)
    assert_allclose(correction.y @ correction.y, nis, rtol=1e-10)
    assert_allclose(covariance.marginal(slots), book.P, atol=1e-10)


def test_the_whitened_innovation_is_white_in_the_order_of_the_observations():
    rng = np.random.default_rng(7)
    covariance, slots, _ = both(rng, 'small')
    sparse, _, R = random_observations(rng, slots, 3)
    prior = covariance.project(sparse, R)
    S, r = prior.S, rng.normal(size=6)

    y = covariance.correction(prior, r).y

    # The first observations whitened by themselves give the first entries.
    for k in (2, 4, 6):
        assert_allclose(y[:k] @ y[:k], r[:k] @ np.linalg.inv(S[:k, :k]) @ r[:k], rtol=1e-10)


def test_transport_is_a_congruence(team):
    rng = np.random.default_rng(8)
    covariance, slots, book = both(rng, team)
    sparse, A = random_transport(rng, len(book.P))

    covariance.transport(sparse)

    assert_allclose(covariance.marginal(slots), A @ book.P @ A.T, rtol=1e-12, atol=1e-12)


def test_a_variable_inserted_after_a_transport_is_independent_of_all_others(team):
    rng = np.random.default_rng(13)
    covariance, slots, book = both(rng, team)
    covariance.transport(random_transport(rng, len(book.P))[0])
    before, P = covariance.marginal(slots), random_covariance(rng, 3)

    slot = covariance.insert(P)

    assert_array_equal(covariance.marginal([*slots, slot]), block_diag(before, P))


def test_rows_after_a_transport_are_a_product(team):
    rng = np.random.default_rng(14)
    _, slots, _ = both(rng, team)

    sparse, H, _ = rows_after_a_transport(rng, slots, 5)

    assert all(len(set(columns)) < len(columns) for columns in sparse.columns)
    assert_allclose(dense(sparse, slots[-1].stop), H, atol=1e-13)


@pytest.mark.parametrize('rows', [random_observations, rows_after_a_transport])
def test_rows_of_an_error_are_a_product(team, rows):
    rng = np.random.default_rng(15)
    _, slots, _ = both(rng, team)
    sparse, H, _ = rows(rng, slots, 5)
    dx = rng.normal(size=slots[-1].stop)

    assert_allclose(sparse.of(dx), H @ dx, atol=1e-13)


def busy(covariance, slots, rng, rounds):
    """Drive, add and see with sigma 1e-4 for some rounds, from metres of uncertainty."""
    for k in range(rounds):
        Phi = np.array([[1.0, 0.0, -rng.normal()], [0.0, 1.0, rng.normal()], [0.0, 0.0, 1.0]])
        covariance.propagate(slots[0], Phi, np.diag([1e-2, 1e-2, 1e-4]))
        if k < 40:
            b = rng.uniform(-9.0, 9.0, 2)
            F = np.array([[1.0, 0.0, -b[1]], [0.0, 1.0, b[0]]])
            slots.append(covariance.augment(slots[0], F, 1e-8 * np.eye(2)))
        observed = rng.integers(1, len(slots), 3)
        columns = np.array([[*slots[0].indices, *slots[i].indices] for i in observed])
        H = np.tile([[-1.0, 0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0, 1.0]], (3, 1, 1))
        H[:, :, 2] = rng.uniform(-9.0, 9.0, (3, 2))
        prior = covariance.project(SparseRows(columns, H), np.tile(1e-8 * np.eye(2), (3, 1, 1)))
        covariance.condition(covariance.correction(prior, rng.normal(size=6)))


def test_after_a_thousand_updates_the_covariance_is_valid():
    covariance = Covariance()
    slots = [covariance.insert(np.diag([100.0, 100.0, 1.0]))]

    busy(covariance, slots, np.random.default_rng(9), 1000)

    P = covariance.marginal(slots)
    assert_array_equal(P, P.T)
    rest = len(P) - 7
    assert_array_equal(covariance.marginal([*slots[3:], *slots[:3]])[:rest, rest:], P[7:, :7])
    assert np.diag(P).min() > 0.0
    # Rounding relative to the variance at the beginning.
    assert np.linalg.eigvalsh(P).min() > -1e-12 * 100.0


def test_an_indefinite_innovation_covariance_is_an_error():
    covariance = Covariance()
    slot = covariance.insert(np.diag([1.0, -5.0]))
    H = SparseRows(slot.indices[None], np.eye(2)[None])

    prior = covariance.project(H, np.eye(2)[None])

    with pytest.raises(ArithmeticError, match='not positive definite at 2'):
        covariance.correction(prior, np.zeros(2))


@pytest.mark.parametrize('index', [0, 1, -1])
def test_a_removal_keeps_every_bit_of_the_others(team, index):
    covariance, left, _ = both(np.random.default_rng(10), team)
    gone = left.pop(index)
    before = covariance.marginal(left)

    covariance.remove([gone], left)

    assert covariance.dimension == len(before)
    assert_array_equal(covariance.marginal(left), before)
    assert [i for slot in left for i in slot.indices] == [*range(len(before))]


def test_the_order_of_removals_does_not_matter():
    left_behind = []
    for order in ([1, 5, 20], [20, 1, 5], [5, 20, 1]):
        covariance, left, _ = both(np.random.default_rng(11), 'beyond 64 states')
        for gone in [left[k] for k in order]:
            left.remove(gone)
            covariance.remove([gone], left)
        left_behind.append(covariance.marginal(left))

    assert_array_equal(left_behind[1], left_behind[0])
    assert_array_equal(left_behind[2], left_behind[0])


def test_after_a_removal_the_filter_continues_as_without_the_variable(team):
    rng = np.random.default_rng(12)
    covariance, slots, _ = both(rng, team)
    extra = [covariance.augment(slots[0], rng.normal(size=(2, 3)), np.eye(2)) for _ in range(9)]
    slots += [extra[-1]]
    for k, gone in enumerate(extra[:-1]):
        covariance.remove([gone], [*slots, *extra[k + 1:-1]])
    book = Textbook(covariance.marginal(slots))

    F, Phi, N = rng.normal(size=(2, 3)), rng.normal(size=(3, 3)), random_covariance(rng, 2)
    slots.append(covariance.augment(slots[0], F, N))
    book.augment(slots[0], F, N)
    covariance.propagate(slots[0], Phi, np.eye(3))
    book.propagate(slots[0], Phi, np.eye(3))
    sparse, H, R = random_observations(rng, slots, 4)
    prior, r = covariance.project(sparse, R), rng.normal(size=8)
    correction = covariance.correction(prior, r)
    covariance.condition(correction)

    assert_array_equal(prior.P[covariance.dimension:], 0.0)
    # As for an update without a removal.
    assert_allclose(correction.dx, book.update(H, block_diag(*R), r)[0], atol=1e-10)
    assert_allclose(covariance.marginal(slots), book.P, atol=1e-10)
