# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.evaluation.coverage import (
    independent_samples, landmark_consistency, pose_consistency, REGIONS)
from fej_slam_ros.evaluation.run_result import MatchedPoses


def consistent(n, scale, rng):
    """Return n poses with errors scale times those that their covariances imply."""
    roots = rng.normal(size=(n, 3, 3)) + 2.0 * np.eye(3)
    P = roots @ roots.transpose(0, 2, 1) * 1e-2
    errors = np.einsum('nij,nj->ni', np.linalg.cholesky(P), rng.normal(size=(n, 3)))
    return MatchedPoses(np.arange(n), scale * errors, P, np.zeros((n, 3)), 'map')


def test_coverage_and_mean_nees_of_consistent_poses_are_as_expected():
    _, statistics = pose_consistency(consistent(4000, 1.0, np.random.default_rng(1)))

    for name, inside in statistics.coverage().items():
        # Four standard deviations of a share of 4000 samples are below 0.032.
        assert inside == pytest.approx(REGIONS[name], abs=0.032)
    low, high = band_per_dof(4000 * statistics.dof)
    assert low < statistics.values.mean() < high


def test_overconfident_poses_are_above_the_band():
    _, statistics = pose_consistency(consistent(200, 1.5, np.random.default_rng(2)))

    assert statistics.values.mean() > band_per_dof(200 * statistics.dof)[1]
    assert statistics.coverage()['95_percent'] < 0.9


def test_an_exactly_known_pose_has_no_nees():
    matched = consistent(3, 1.0, np.random.default_rng(3))
    matched.P[1] = 0.0

    values, statistics = pose_consistency(matched)

    assert np.isnan(values).tolist() == [False, True, False]
    assert len(statistics.values) == 2


@pytest.mark.parametrize('rho', [0.0, 0.8])
def test_correlation_reduces_the_number_of_independent_samples(rho):
    rng = np.random.default_rng(4)
    n = 20_000
    x = np.zeros(n)
    for k, noise in enumerate(rng.normal(size=n - 1), 1):
        x[k] = rho * x[k - 1] + noise

    # The variance of the mean of a first-order process; the estimate of it is good to 20 %.
    assert independent_samples(x) == pytest.approx(n * (1 - rho) / (1 + rho), rel=0.2)


def test_a_constant_series_is_one_independent_sample():
    assert independent_samples(np.full(10, 3.0)) == 1.0


def test_landmarks_have_no_number_of_independent_samples():
    statistics = landmark_consistency(np.ones((3, 2)), np.broadcast_to(np.eye(2), (3, 2, 2)))

    assert statistics.independent is None
