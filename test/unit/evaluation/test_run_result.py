# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Estimated poses are matched with ground truth at their stamps."""

import numpy as np

from fej_slam_ros.core.ground_truth import RecordedTruth
from fej_slam_ros.core.records import NS, TruePose
from fej_slam_ros.evaluation.run_result import EstimatedTrajectory, match

#: At 1.7e18 ns floats are 256 ns apart.
BEGIN = 1_700_000_000 * NS


def estimated(stamps):
    n = len(stamps)
    return EstimatedTrajectory(
        np.array(stamps), np.zeros((n, 3)), np.broadcast_to(np.eye(3), (n, 3, 3)), 'map', n)


def truth_of(stamps, poses):
    truth = RecordedTruth()
    for stamp, pose in zip(stamps, poses):
        truth.add(TruePose('r1', int(stamp), pose))
    return truth


def test_truth_is_not_interpolated_outside_its_poses_or_across_long_gaps():
    seconds = np.array([0.0, 0.4, 2.0, 2.2])
    truth = truth_of(
        BEGIN + (seconds * NS).astype(np.int64),
        np.column_stack([seconds, 2.0 * seconds, np.zeros(4)]))
    stamps = [BEGIN + round(t * NS) for t in (-0.1, 0.0, 0.1, 1.0, 2.0, 2.1, 2.3)]

    matched = match('r1', estimated(stamps), truth)

    # The limit of a gap is 0.5 s, also between estimates.
    np.testing.assert_allclose((matched.stamps - BEGIN) / NS, [0.0, 0.1, 2.0, 2.1])
    np.testing.assert_allclose(matched.true[:, 1], [0.0, 0.2, 4.0, 4.2], atol=1e-12)


def test_estimates_are_interpolated_at_isolated_true_poses():
    stamps = BEGIN + np.arange(0, 30 * NS, NS // 10)
    seconds = (stamps - BEGIN) / NS
    poses = np.column_stack([2.0 * seconds, np.zeros_like(seconds), np.zeros_like(seconds)])
    P = np.eye(3) * (1.0 + seconds)[:, None, None]
    trajectory = EstimatedTrajectory(stamps, poses, P, 'map', len(stamps))
    # One every ten seconds, of which one is at a stamp of an estimate and one beyond them.
    true = np.array([3.04, 13.1, 23.06, 33.0])
    truth = truth_of(BEGIN + (true * NS).round().astype(np.int64), np.zeros((4, 3)))

    matched = match('r1', trajectory, truth)

    np.testing.assert_allclose((matched.stamps - BEGIN) / NS, true[:3], atol=1e-6)
    np.testing.assert_allclose(matched.poses[:, 0], 2.0 * true[:3], atol=1e-6)
    np.testing.assert_allclose(matched.P[:, 0, 0], 1.0 + true[:3], atol=1e-6)


def test_estimates_are_not_interpolated_across_long_gaps():
    matched = match('r1', estimated([0, NS]), truth_of([NS // 2], np.zeros((1, 3))))

    assert len(matched.stamps) == 0


def test_headings_are_interpolated_across_pi():
    truth = truth_of([0, 200_000_000], np.array([[0.0, 0.0, 3.1], [0.0, 0.0, -3.1]]))

    (pose,) = match('r1', estimated([100_000_000]), truth).true

    assert abs(abs(pose[2]) - np.pi) < 1e-12


def test_true_poses_at_equal_stamps_keep_every_bit():
    stamps = BEGIN + np.arange(50) * 123_456_789
    poses = np.random.default_rng(3).normal(size=(50, 3))

    np.testing.assert_array_equal(
        match('r1', estimated(stamps), truth_of(stamps, poses)).true, poses)


def test_robot_without_truth_has_no_matched_poses():
    matched = match('r2', estimated([0, 1]), truth_of([0, 1], np.zeros((2, 3))))

    assert matched.poses.shape == matched.true.shape == (0, 3)
