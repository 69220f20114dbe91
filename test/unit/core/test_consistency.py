# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""
Consistency measures against scipy.stats, and the consistency of the filters themselves.

The runs of one test take 1 to 6 s together; all numbers in comments are those of the fixed seeds.
"""

from functools import cache
from math import radians

import numpy as np
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.chi_square import band_per_dof
from fej_slam_ros.core.consistency import nees, nees_per_dof, NisMonitor
from fej_slam_ros.sim.sensors import SensorSettings
from helpers.core import circles, estimate


@pytest.mark.parametrize('size', [2, 3])
def test_the_mean_nees_of_a_consistent_estimate_is_its_dimension(size):
    rng = np.random.default_rng(1)
    A = rng.normal(size=(size, size))
    errors = rng.multivariate_normal(np.zeros(size), A @ A.T, size=4000)

    total = sum(nees(error, A @ A.T) for error in errors)

    low, high = chi2.interval(0.9999, 4000 * size)
    assert low < total < high


def test_nees_weights_errors_by_the_inverse_covariance():
    error, P = np.array([1.0, 2.0, 0.1]), np.diag([1.0, 4.0, 0.01])

    assert nees(error, P) == pytest.approx(3.0)
    assert nees(2.0 * error, P) == pytest.approx(12.0)
    assert nees_per_dof(error, P) == pytest.approx(1.0)


def test_normalised_innovations_add_up():
    nis = NisMonitor()
    nis.add(0, [1.0, 2.0])
    nis.add(1, [1.5])

    assert (nis.total, nis.dof) == (4.5, 6)
    assert nis.nis_per_dof() == pytest.approx(0.75)


def test_the_nis_ratio_and_band_are_of_the_latest_two_hundred_observations():
    nis = NisMonitor()
    nis.add(0, [100.0] * 50)
    nis.add(1, [2.0] * 199)
    low, high = chi2.interval(0.999999, 400) / np.array(400)

    assert nis.nis_per_dof() == pytest.approx((100.0 + 199 * 2.0) / 400)
    assert nis.band() == pytest.approx((low, high))


def test_the_time_outside_the_band_starts_at_the_last_stamp_inside_it():
    nis = NisMonitor()

    outside_for = []
    for stamp, value in [(0, 2.0), (10, 2.0), (20, 60.0), (30, 60.0), (40, 2.0)]:
        nis.add(stamp, [value] * 200)
        outside_for.append(nis.outside_for)

    assert outside_for == [0, 0, 10, 20, 0]


def scores(estimator):
    return [score.mean_nees_per_dof() for score in estimator.evaluation.scores.values()]


#: Standard deviations [m, m, rad], far above the errors of relative positions with these sensors.
ANCHOR_SIGMA = (0.1, 0.2, 0.05)
SENSORS = SensorSettings((0.1, 0.1, radians(1.0)), (0.2, 0.2))


@cache
def nees_with_an_uncertain_anchor(form):
    """Return NEES/3 over 30 worlds with a wrong initial pose of the anchor."""
    values = []
    for seed in range(30):
        anchor_pose = tuple(np.random.default_rng(1000 + seed).normal(0.0, ANCHOR_SIGMA))
        records = circles(seed, landmarks=20, sensors=SENSORS)
        estimator, _ = estimate(
            records, anchor_pose=anchor_pose, anchor_sigma=ANCHOR_SIGMA, start_covariance=form,
            gate_probability=1.0)
        values.append(scores(estimator))
    return np.mean(values)


def test_the_default_start_covariance_is_consistent_with_an_uncertain_anchor():
    # 1.04 here; the 97.5 % bound of 30 independent anchor poses is 1.3.
    assert nees_with_an_uncertain_anchor('anchored') < 1.3


def test_the_start_covariance_of_the_paper_is_not():
    # 3.99 here.
    assert nees_with_an_uncertain_anchor('independent') > 2.0


@cache
def mean_nees(kind):
    """Return the mean NEES/3 over 20 worlds of three loops with the sensors of [Liu]."""
    runs = [
        estimate(circles(seed, landmarks=20, loops=3), filter=kind, gate_probability=1.0)[0]
        for seed in range(20)]
    return np.mean([scores(estimator) for estimator in runs])


def test_fej_is_consistent_where_the_standard_filter_is_overconfident():
    # 1.02 and 1.85 here.
    assert mean_nees('fej') < 1.3
    assert mean_nees('standard') > 1.5 * mean_nees('fej')


def test_the_innovations_of_the_ideal_filter_are_chi_square():
    runs = [estimate(circles(seed), filter='ideal', gate_probability=1.0)[0] for seed in range(20)]

    nis = [robot for estimator in runs for robot in estimator.innovations.nis.values()]
    dof = sum(robot.dof for robot in nis)
    low, high = band_per_dof(dof, 0.999)
    assert low < sum(robot.total for robot in nis) / dof < high
