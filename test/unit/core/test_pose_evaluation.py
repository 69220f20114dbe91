# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Scores of poses are those of hand-worked cases, whenever their ground truth comes."""

import numpy as np
import pytest

from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.pose_evaluation import PoseEvaluation, PoseScore
from fej_slam_ros.core.records import TruePose


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
