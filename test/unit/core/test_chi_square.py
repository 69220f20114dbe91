# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Quantiles and bands of chi-square against scipy.stats."""

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.chi_square import (
    band_per_dof, chi_square_limit, chi_square_quantile, distances_where_tested,
    increases_of_chi_square)

DOFS = (1, 2, 3, 30, 401, 5000)
# Two implementations of the inverse of the same incomplete gamma function.
ROUNDING = 1e-12


@pytest.mark.parametrize('dof', DOFS)
@pytest.mark.parametrize('probability', [0.0, 0.5, 0.99, 0.9999, 1.0 - 1e-9, 1.0])
def test_a_quantile_is_that_of_scipy_stats(dof, probability):
    assert chi_square_quantile(dof, probability) == pytest.approx(
        chi2.ppf(probability, dof), rel=ROUNDING)


@pytest.mark.parametrize('dof', DOFS)
@pytest.mark.parametrize('tail', [0.0, 1e-20, 1e-6, 0.5, 1.0])
def test_a_limit_is_exceeded_with_the_probability_of_the_tail(dof, tail):
    assert chi_square_limit(dof, tail) == pytest.approx(chi2.isf(tail, dof), rel=ROUNDING)


@pytest.mark.parametrize('dof', DOFS)
def test_a_band_leaves_equal_probabilities_on_both_sides(dof):
    assert np.array(band_per_dof(dof)) * dof == pytest.approx(
        chi2.interval(0.95, dof), rel=ROUNDING)


@pytest.mark.parametrize(('runs', 'probability'), [(100, 0.95), (1, 0.95), (30, 0.5)])
def test_a_band_per_degree_of_freedom_holds_the_mean_nees_of_consistent_runs(runs, probability):
    rng = np.random.default_rng(1)
    means = rng.chisquare(3, (20_000, runs)).mean(axis=1) / 3

    low, high = band_per_dof(3 * runs, probability)

    tail = (1.0 - probability) / 2.0
    sd = np.sqrt(tail * (1.0 - tail) / 20_000)  # of a share of the draws
    assert np.mean(means < low) == pytest.approx(tail, abs=4.0 * sd)
    assert np.mean(means > high) == pytest.approx(tail, abs=4.0 * sd)


def test_tested_distances_are_mahalanobis_distances_of_definite_covariances():
    rng = np.random.default_rng(2)
    r, A = rng.normal(size=(20, 3)), rng.normal(size=(20, 3, 3))
    S = A @ A.transpose(0, 2, 1) + 0.1 * np.eye(3)

    d2 = distances_where_tested(r, S)

    assert d2 == pytest.approx([e @ np.linalg.solve(S_e, e) for e, S_e in zip(r, S)], rel=1e-10)


def test_directions_in_which_nothing_else_tests_a_residual_do_not_count():
    r, S = np.array([[3.0, 1e-9]]), np.diag([2.0, 1e-12])[None]

    assert distances_where_tested(r, S) == pytest.approx([4.5])


def test_chi_square_increases_as_by_a_new_fit_with_each_point():
    rng = np.random.default_rng(1)
    D, z, A = rng.normal(size=(16, 3)), rng.normal(size=16), rng.normal(size=(16, 16))
    S = A @ A.T + np.eye(16)

    def fit(rows):
        W = np.linalg.inv(S[np.ix_(rows, rows)])
        x = np.linalg.solve(D[rows].T @ W @ D[rows], D[rows].T @ W @ z[rows])
        r = z[rows] - D[rows] @ x
        return x, r @ W @ r

    x, chi_square = fit([*range(10)])
    expected = [fit([*range(10), k, k + 1])[1] - chi_square for k in (10, 12, 14)]

    assert increases_of_chi_square(z - D @ x, D, S, 10) == pytest.approx(expected, rel=1e-9)
