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
from fej_slam_ros.core.consistency import nees, nees_per_dof, NisMonitor, PoseEvaluation, PoseScore
from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import TruePose
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


def test_rmse_is_of_all_poses_and_nees_of_those_with_a_definite_covariance():
    score = PoseScore()
    score.add(
        np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.2]]),
        np.array([np.zeros((3, 3)), np.diag([9.0, 16.0, 0.04])]))

    assert (score.steps, score.with_nees) == (2, 1)
    assert score.position_rmse() == pytest.approx(5.0 / np.sqrt(2.0))
    assert score.heading_rmse() == pytest.approx(0.2 / np.sqrt(2.0))
    assert score.mean_nees_per_dof() == pytest.approx(1.0)
    assert PoseScore().mean_nees_per_dof() is None


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


def test_a_pose_is_scored_as_soon_as_its_truth_is_known():
    truth = RecordedTruth()
    evaluation = PoseEvaluation(truth)
    truth.add(TruePose('r1', 0, np.zeros(3)))
    evaluation.add('r1', 0, np.zeros(3), np.eye(3))
    evaluation.add('r1', 5, np.array([1.5, 2.0, 0.0]), np.eye(3))
    assert evaluation.scores['r1'].steps == 1
    truth.add(TruePose('r1', 10, np.array([2.0, 0.0, 0.0])))
    evaluation.add('r1', 10, np.array([2.0, 0.0, 0.0]), np.eye(3))

    # The truth interpolated at 5 is (1, 0, 0), the error (0.5, 2).
    assert evaluation.scores['r1'].steps == 3
    assert evaluation.scores['r1'].position_rmse() == pytest.approx(np.sqrt(4.25 / 3.0))


def test_scores_do_not_depend_on_when_they_are_read():
    truths, rng = (RecordedTruth(), RecordedTruth()), np.random.default_rng(1)
    evaluations = [PoseEvaluation(truth) for truth in truths]
    for stamp in range(250):
        error = rng.normal(size=3)
        for truth, evaluation in zip(truths, evaluations):
            truth.add(TruePose('r1', stamp, np.zeros(3)))
            evaluation.add('r1', stamp, error, np.eye(3))
        assert evaluations[0].scores['r1'].steps == stamp + 1

    # Sums in the same order have the same bits.
    assert evaluations[0].scores == evaluations[1].scores


def test_poses_before_a_robot_leaves_the_map_are_scored():
    truth = RecordedTruth()
    evaluation = PoseEvaluation(truth)
    for stamp in range(0, 100, 10):
        evaluation.add('r1', stamp, np.ones(3), np.eye(3))
        truth.add(TruePose('r1', stamp - 5, np.zeros(3)))
    for stamp in range(100, 200, 10):
        evaluation.pass_over('r1', stamp)
        truth.add(TruePose('r1', stamp - 5, np.zeros(3)))

    assert evaluation.scores['r1'].steps == 10


def test_a_pose_without_truth_is_not_scored():
    truth = RecordedTruth()
    evaluation = PoseEvaluation(truth)
    truth.add(TruePose('r1', 10, np.zeros(3)))
    evaluation.add('r1', 0, np.ones(3), np.eye(3))
    evaluation.add('r2', 0, np.ones(3), np.eye(3))

    assert evaluation.scores == {}


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


def test_a_pose_with_a_singular_covariance_has_no_nees():
    # A differential drive without slip: P is singular but for rounding of either sign.
    direction = np.array([3.0, 4.0, 1.0])
    for rounding in (-1e-17, 0.0, 1e-17):
        score = PoseScore()

        score.add(
            np.array([[0.1, 0.0, 0.0]]),
            np.outer(direction, direction)[None] + rounding * np.eye(3))

        assert (score.steps, score.with_nees, score.mean_nees_per_dof()) == (1, 0, None)


def test_nees_does_not_depend_on_the_units_of_the_covariance():
    score = PoseScore()

    score.add(np.array([[1e3, 1e-6, 0.0]]), np.diag([1e6, 1e-12, 1e-12])[None])

    # One sigma in x and in y, none in the heading.
    assert score.mean_nees_per_dof() == pytest.approx(2.0 / 3.0)
