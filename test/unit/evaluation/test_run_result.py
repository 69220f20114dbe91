# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np

from fej_slam_ros.core.records import NS
from fej_slam_ros.evaluation.run_result import compared, EstimatedTrajectory, TrueTrajectory

#: At 1.7e18 ns floats are 256 ns apart.
BEGIN = 1_700_000_000 * NS


def estimated(stamps):
    n = len(stamps)
    return EstimatedTrajectory(
        np.array(stamps), np.zeros((n, 3)), np.broadcast_to(np.eye(3), (n, 3, 3)), 'map', n)


def test_truth_is_interpolated_between_near_poses_only():
    seconds = np.array([0.0, 0.4, 2.0, 2.2])
    stamps = BEGIN + (seconds * NS).astype(np.int64)
    truth = TrueTrajectory(stamps, np.column_stack([seconds, 2.0 * seconds, np.zeros(4)]))
    asked = [BEGIN + round(t * NS) for t in (-0.1, 0.0, 0.1, 1.0, 2.0, 2.1, 2.3)]

    told = compared(estimated(asked), truth)

    # Before and after the truth, and within a gap above 0.5 s, nothing is known.
    np.testing.assert_allclose((told.stamps - BEGIN) / NS, [0.0, 0.1, 2.0, 2.1])
    np.testing.assert_allclose(told.true[:, 1], [0.0, 0.2, 4.0, 4.2], atol=1e-12)


def test_headings_are_interpolated_across_pi():
    stamps = np.array([0, 200_000_000])
    truth = TrueTrajectory(stamps, np.array([[0.0, 0.0, 3.1], [0.0, 0.0, -3.1]]))

    (pose,) = truth.at(np.array([100_000_000]))

    assert abs(abs(pose[2]) - np.pi) < 1e-12


def test_true_poses_at_equal_stamps_keep_every_bit():
    rng = np.random.default_rng(3)
    stamps = BEGIN + np.arange(50) * 123_456_789
    poses = rng.normal(size=(50, 3))

    np.testing.assert_array_equal(TrueTrajectory(stamps, poses).at(stamps), poses)
