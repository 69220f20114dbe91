# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The newest pose of a robot between two solutions."""

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.records import Observation
from fej_slam_ros.core.smoothing import newest_pose
from fej_slam_ros.core.smoothing.newest_pose import NearMarginal, NewestPose

POINTS = np.array([[1.0, 0.0], [9.0, 0.0], [2.0, 0.0], [8.0, 0.0], [7.0, 0.0]])


@pytest.fixture
def newest():
    """Return a robot at the origin that knows five landmarks."""
    P = np.diag([0.2, 0.2, 0.1, *np.full(10, 0.05)])
    return NewestPose(np.zeros(3), range(5), POINTS, NearMarginal(np.arange(5), P))


def test_of_too_many_landmarks_the_nearest_ones_are_kept(newest, monkeypatch):
    monkeypatch.setattr(newest_pose, 'MAX_FILTER_LANDMARKS', 2)

    newest.observe([Observation(0, POINTS[0], np.eye(2))])

    assert newest.points().keys() == {0, 2}


def test_a_pose_whose_observations_cannot_be_used_is_that_before_them(newest, monkeypatch):
    x, P, correction, calls = newest.x, newest.P, Covariance.correction, []

    def fails_at_last(self, prior, r):
        calls.append(prior)
        if len(calls) == newest_pose.UPDATE_ITERATIONS:
            raise ArithmeticError('not definite')
        return correction(self, prior, r)

    monkeypatch.setattr(Covariance, 'correction', fails_at_last)
    newest.observe([Observation(0, POINTS[0] + 0.5, 0.01 * np.eye(2))])

    assert newest.error == 'not definite'
    assert_array_equal(newest.x, x)
    assert_array_equal(newest.P, P)


def test_a_landmark_that_left_the_map_leaves_the_others_with_their_covariances():
    P = np.arange(49.0).reshape(7, 7)
    of_first_and_third = NearMarginal(np.array([0, 2]), P)

    # Of three landmarks, 5, 6 and 7 in the map, 5 and 6 have left and 9 is new.
    kept = of_first_and_third.renumbered(np.array([5, 6, 7]), np.array([9, 7]))

    assert kept.landmarks.tolist() == [1]
    rows = [0, 1, 2, 5, 6]
    assert_array_equal(kept.P, P[rows][:, rows])


def test_an_error_is_over_with_the_next_observations_that_can_be_used(newest):
    newest.error = 'not definite'

    newest.observe([Observation(0, POINTS[0], 0.01 * np.eye(2))])

    assert newest.error == ''
