# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Algorithm 2 of [Andersson]: duplicate landmarks are merged, and no others."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.stats import chi2

from fej_slam_ros.core.csam import landmark_matching
from fej_slam_ros.core.csam.landmark_matching import match_landmarks
from fej_slam_ros.core.csam.maps import JointMap
from fej_slam_ros.core.smoothing.factors import LandmarkFactors, OdometryFactors, Values
from fej_slam_ros.core.smoothing.problem import Problem

SMALL = 1e-4 * np.eye(2)
EXACT = 1e-14 * np.eye(3)


def two_still_robots(of_p, of_q, R=SMALL, Q=EXACT, seen_from=(0, 1)):
    """
    Return the joint map of two still robots from the points that each observes.

    Q is the covariance of the second of the two poses from which they are seen.

    """
    points = np.array([*of_p, *of_q], float)
    pose = np.repeat(seen_from, [len(of_p), len(of_q)])
    observations = LandmarkFactors(pose, np.arange(len(points)), points, R)
    odometry = OdometryFactors(np.array([0]), np.array([1]), np.zeros((1, 3)), Q)
    landmarks = tuple(
        (('p' if k < len(of_p) else 'q', k),) for k in range(len(points)))
    return JointMap(
        ('p', 'q'), Problem(odometry, observations), Values(np.zeros((2, 3)), points),
        {'p': 0, 'q': 1}, {'p': np.zeros(3), 'q': np.zeros(3)}, landmarks).solved()


def pairs_of(joint):
    """Return the IDs of the merged landmarks."""
    return [tuple(id_ for _, id_ in keys) for keys in joint.landmarks if len(keys) > 1]


def test_a_pair_inside_the_gate_is_merged_at_its_weighted_mean():
    joint = match_landmarks(two_still_robots([[3.0, 1.0], [9.0, 9.0]], [[3.02, 1.0]]))

    assert pairs_of(joint) == [(0, 2)]
    assert_allclose(joint.values.points[0], [3.01, 1.0], atol=1e-4)
    # The difference has twice the variance of each.
    assert joint.chi_square == pytest.approx(0.02**2 / 2e-4, rel=1e-2)


def test_pairs_that_are_ambiguous_are_merged_once_another_one_has_fixed_the_maps():
    # The maps are off by a metre, with a sigma of one; two of three landmarks are 0.8 m apart.
    points = np.array([[0.0, 20.0], [9.0, 9.0], [9.8, 9.0]])

    joint = match_landmarks(two_still_robots(
        points, points + np.array([1.0, 0.0]), Q=np.diag([1.0, 1.0, 1e-8])))

    assert pairs_of(joint) == [(0, 3), (1, 4), (2, 5)]


def test_a_pair_outside_the_gate_is_not_merged():
    apart = 1.1 * np.sqrt(2e-4 * chi2.ppf(0.99, 2))

    assert pairs_of(match_landmarks(two_still_robots([[3.0, 1.0]], [[3.0 + apart, 1.0]]))) == []


@pytest.mark.parametrize('order', [1, -1])
def test_an_ambiguous_landmark_is_not_merged(order):
    two, one = [[3.0, 1.0], [3.03, 1.0]], [[3.015, 1.0]]

    joint = match_landmarks(two_still_robots(*[two, one][::order]))

    assert pairs_of(joint) == []


def test_landmarks_of_one_robot_are_never_merged():
    joint = match_landmarks(two_still_robots([[3.0, 1.0], [3.001, 1.0]], [[9.0, 9.0]]))

    assert pairs_of(joint) == []


#: Of landmarks that are as exact in the map as one from the other, and that share a large error.
SHARED_ERRORS = {'none': {}, 'a metre': {'Q': np.diag([1.0, 1.0, 1e-8]), 'seen_from': (1, 1)}}


@pytest.mark.parametrize('shared', SHARED_ERRORS)
def test_an_error_that_landmarks_share_does_not_make_them_ambiguous(shared):
    points = [[3.0, 1.0], [3.5, 1.0]]

    joint = match_landmarks(two_still_robots(points, points, **SHARED_ERRORS[shared]))

    assert pairs_of(joint) == [(0, 2), (1, 3)]


@pytest.mark.parametrize('shared', SHARED_ERRORS)
def test_pairs_that_fail_the_joint_test_are_released_worst_first(shared):
    # Each is inside the gate of 9.2. All seven raise chi-square by 46.5, six without the worst by
    # 37.4, five without the next by 28.4; at 0.999 the limits are 36.1, 32.9 and 29.6.
    raised = np.array([1.0, 1.0, 9.1, 8.9, 9.0, 8.8, 8.7])
    places = 5.0 * np.array([[1, 1], [-1, 2], [1, -3], [-2, -3], [3, 3], [-4, 0], [4, -1]])
    seen_by_q = places + np.column_stack([np.zeros(7), np.sqrt(2e-4 * raised)])

    joint = match_landmarks(two_still_robots(places, seen_by_q, **SHARED_ERRORS[shared]))

    assert pairs_of(joint) == [(0, 7), (1, 8), (3, 10), (5, 12), (6, 13)]
    assert joint.chi_square == pytest.approx(28.4, rel=1e-2)


def test_the_pair_that_is_released_is_not_that_of_an_inexact_landmark_that_is_far_off():
    # As above, but the last landmark is ten times less exact, and so is its pair farther apart.
    raised, scale = np.array([9.1, 8.9, 9.0, 8.8, 8.7]), np.array([1.0, 1.0, 1.0, 1.0, 10.0])
    places = 5.0 * np.array([[1, 1], [-1, 2], [1, -3], [-2, -3], [3, 3]])
    seen_by_q = places + np.column_stack([np.zeros(5), scale * np.sqrt(2e-4 * raised)])
    R = np.tile(scale, 2)[:, None, None] ** 2 * SMALL

    joint = match_landmarks(two_still_robots(places, seen_by_q, R))

    # All raise chi-square by 44.5, four by 35.4, three by 26.4, two by 17.5; the limits at 0.999
    # are 29.6, 26.1, 22.5 and 18.5.
    assert pairs_of(joint) == [(3, 8), (4, 9)]


def test_landmarks_of_three_robots_are_merged():
    joint = two_still_robots([[3.0, 1.0], [9.0, 9.0]], [[3.01, 1.0], [9.0, 9.01]])
    keys = (('p', 0), ('r', 1), ('q', 2), ('q', 3))

    third = match_landmarks(replace(joint, landmarks=tuple((key,) for key in keys)))

    assert pairs_of(third) == [(0, 2), (1, 3)]


def test_of_two_landmarks_that_fit_a_third_but_not_each_other_the_nearer_is_merged():
    # At 3.00, 2.97 and 3.02 m; the gate is 43 mm wide between two, 37 mm from the mean of two.
    joint = two_still_robots([[3.0, 1.0], [2.97, 1.0]], [[3.02, 1.0]])
    keys = (('p', 0), ('r', 1), ('q', 2))

    third = match_landmarks(replace(joint, landmarks=tuple((key,) for key in keys)))

    assert pairs_of(third) == [(0, 2)]


def test_different_shared_ids_are_never_merged():
    joint = two_still_robots([[3.0, 1.0]], [[3.0, 1.0]])

    shared = match_landmarks(replace(joint, landmarks=((('', 1),), (('', 2),))))

    assert pairs_of(shared) == []


def test_maps_of_many_landmarks_with_shared_ids_need_no_comparison_of_pairs(monkeypatch):
    joint = two_still_robots([[3.0, 1.0]] * 3, [[3.0, 1.0]] * 3)
    shared = replace(joint, landmarks=tuple((('', k),) for k in range(6)))
    monkeypatch.setattr(landmark_matching, '_are_apart', None)

    assert match_landmarks(shared) is shared
