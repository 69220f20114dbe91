# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The trajectory of one robot, of which not all poses are kept."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from fej_slam_ros.core.csam.robot_trajectory import RobotTrajectory
from fej_slam_ros.core.records import Motion, Observation

Q = 1e-6 * np.eye(3)


@pytest.mark.parametrize('turn', [0.0, 0.4])
def test_a_given_pose_has_its_own_covariance_also_between_keyframes(turn):
    trajectory = RobotTrajectory('r1', 0, (), 100)
    trajectory.add_between_keyframes(Motion('r1', 1, np.array([0.0, 0.0, turn]), Q), ())
    pose, P = np.array([2.0, 1.0, 0.7]), np.diag([1e-4, 1.0, 1e-2])

    trajectory.place(2, pose, P, ())

    # The only keyframe, where the frame begins, is exact.
    assert_allclose(trajectory.newest().pose, pose, atol=1e-12)
    assert_allclose(trajectory.newest().P, P, atol=1e-12)


def test_the_covariance_of_the_last_keyframe_is_added_twice_to_that_of_a_given_pose():
    trajectory = RobotTrajectory('r1', 0, (), 100)
    trajectory.add(Motion('r1', 1, np.array([3.0, 0.0, 0.0]), np.diag([0.04, 0.09, 0.01])), ())
    P = np.diag([1e-4, 1.0, 1e-2])

    trajectory.place(2, np.array([3.0, 5.0, 0.7]), P, ())

    # Phi = [1 0 -5; 0 1 0; 0 0 1] takes the error of the keyframe 5 m to the left of it.
    carried = np.array([[0.04 + 25.0 * 0.01, 0.0, -0.05], [0.0, 0.09, 0.0], [-0.05, 0.0, 0.01]])
    assert_allclose(trajectory.newest().P, P + 2.0 * carried, atol=1e-12)


def test_an_observation_since_a_robot_was_lost_has_the_stamp_of_its_pose():
    trajectory = RobotTrajectory('r1', 0, (), 100)
    first, second = (Observation(id_, np.array([2.0, 1.0]), np.eye(2)) for id_ in (7, 8))

    trajectory.lose(1, (first,))
    trajectory.add(Motion('r1', 2, np.array([1.0, 0.0, 0.0]), Q), (first, second))

    assert trajectory.lost_observations() == [(1, 7), (2, 7), (2, 8)]
