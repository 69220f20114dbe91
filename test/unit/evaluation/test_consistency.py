# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from fej_slam_ros.evaluation.consistency import (
    independent_samples, nis_band, rate_points, rate_poses, REGIONS)
from fej_slam_ros.evaluation.run_result import MatchedPoses


def consistent(n, scale, rng):
    """Return n poses whose errors are scale times as large as claimed."""
    roots = rng.normal(size=(n, 3, 3)) + 2.0 * np.eye(3)
    P = roots @ roots.transpose(0, 2, 1) * 1e-2
    errors = np.einsum('nij,nj->ni', np.linalg.cholesky(P), rng.normal(size=(n, 3)))
    return MatchedPoses(np.arange(n), scale * errors, P, np.zeros((n, 3)), 'map')


def test_errors_as_claimed_lie_inside_as_often_as_they_should():
    _, ratings = rate_poses(consistent(4000, 1.0, np.random.default_rng(1)))

    for name, inside in ratings.coverage().items():
        # Four standard deviations of a share of 4000 samples are below 0.032.
        assert inside == pytest.approx(REGIONS[name], abs=0.032)
    low, high = ratings.band(4000)
    assert low < ratings.values.mean() < high


def test_errors_beyond_what_is_claimed_are_seen():
    _, ratings = rate_poses(consistent(200, 1.5, np.random.default_rng(2)))

    assert ratings.values.mean() > ratings.band(200)[1]
    assert ratings.coverage()['95_percent'] < 0.9


def test_a_pose_that_is_exactly_known_is_not_rated():
    of = consistent(3, 1.0, np.random.default_rng(3))
    of.P[1] = 0.0

    values, ratings = rate_poses(of)

    assert np.isnan(values).tolist() == [False, True, False]
    assert len(ratings.values) == 2


@pytest.mark.parametrize('rho', [0.0, 0.8])
def test_correlated_samples_count_less(rho):
    rng = np.random.default_rng(4)
    n = 20_000
    x = np.zeros(n)
    for k, noise in enumerate(rng.normal(size=n - 1), 1):
        x[k] = rho * x[k - 1] + noise

    # The variance of the mean of a first-order process; the estimate of it is good to 20 %.
    assert independent_samples(x) == pytest.approx(n * (1 - rho) / (1 + rho), rel=0.2)


def test_a_constant_series_counts_once():
    assert independent_samples(np.full(10, 3.0)) == 1.0


def test_landmarks_have_no_band_for_correlated_samples():
    assert rate_points(np.ones((3, 2)), np.broadcast_to(np.eye(2), (3, 2, 2))).independent is None


def test_the_band_of_nis_narrows_with_the_samples():
    (low, high), (inner_low, inner_high) = nis_band(100), nis_band(10_000)

    # Chi-square of k degrees of freedom has the variance 2 k.
    assert low < inner_low < 1.0 < inner_high < high
    assert inner_high - inner_low == pytest.approx(2 * 1.96 * np.sqrt(2 / 10_000), rel=1e-2)
