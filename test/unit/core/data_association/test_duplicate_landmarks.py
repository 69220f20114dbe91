# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Duplicates of a landmark are merged, which conditions the state on their being one point."""

import numpy as np
import pytest

from fej_slam_ros.core.data_association.duplicate_landmarks import merge_duplicates
from fej_slam_ros.core.data_association.landmark_manager import LandmarkManager
from fej_slam_ros.core.ekf.active_submap import AROUND_ROBOTS
from fej_slam_ros.core.ekf.covariance import Covariance
from fej_slam_ros.core.ekf.filter import Filter
from fej_slam_ros.core.ekf.gating import Gate
from fej_slam_ros.core.ekf.linearization import FirstEstimates
from fej_slam_ros.core.ekf.state import JointState
from fej_slam_ros.core.pieces import between_pieces
from helpers.core import make_policy, quarter_turn, unknown_place
from helpers.matching import a_map

POINTS = np.array([[4.0, 0.0], [0.0, 9.0], [4.1, 0.1], [-8.0, 2.0]])


def a_filter(points=POINTS, sigma=0.1):
    """Return a filter whose landmarks are correlated, and these in the order of the points."""
    n = 3 + 2 * len(points)
    A = np.random.default_rng(3).normal(0.0, sigma / np.sqrt(n), (n, n))
    state, _ = a_map(points, A @ A.T + 1e-4 * np.eye(n))
    return Filter(state, FirstEstimates(), Gate(1.0)), [*state.landmarks.values()]


def test_merging_conditions_on_a_zero_difference():
    filter_, (one, _, other, _) = a_filter()
    state = filter_.state
    H = np.zeros((2, 11))
    H[:, one.slot.indices], H[:, other.slot.indices] = np.eye(2), -np.eye(2)
    # The difference in the directions of the robot, in which it is (-0.1, -0.1).
    H[:, 2] = -quarter_turn(POINTS[0] - POINTS[2])
    P, x = state.marginal(state.variables()), state.x_hat.copy()
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T)
    kept = np.delete(np.arange(11), other.slot.indices)

    filter_.equate(one, other)
    state.remove(other)

    # The pseudo-measurement has a variance of 1e-12 m^2, the landmarks one of 1e-2.
    difference = POINTS[0] - POINTS[2]
    np.testing.assert_allclose(state.x_hat, (x - K @ difference)[kept], atol=1e-9)
    np.testing.assert_allclose(
        state.marginal(state.variables()), (P - K @ H @ P)[np.ix_(kept, kept)], atol=1e-11)


def coarsely_started(kind, points=POINTS, unknown=(0.0, 0.0, 0.0)):
    """Return a filter with one bad first estimate, as after a coarse join, and its landmarks."""
    before, (one, *_) = a_filter(points)
    state = before.state
    first = state.x_first.copy()
    first[one.slot.indices] += 1.0, 2.0
    at = first if kind == 'fej' else state.x_hat
    state, _ = a_map(points, state.marginal(state.variables()) + unknown_place(state, at, unknown))
    state.x_first = first
    return Filter(state, make_policy(kind, None), Gate(1.0)), [*state.landmarks.values()]


@pytest.mark.parametrize('kind', ['fej', 'invariant'])
def test_merging_adds_no_information_about_the_global_pose(kind):
    sigma = (0.5, 0.8, 0.3)
    known, (one, _, other, _) = coarsely_started(kind)
    unknown, (one_of_unknown, _, other_of_unknown, _) = coarsely_started(kind, unknown=sigma)

    known.equate(one, other)
    unknown.equate(one_of_unknown, other_of_unknown)

    state = unknown.state
    P, P_known = (s.marginal(s.variables()) for s in (state, known.state))
    at = state.x_first if kind == 'fej' else state.x_hat
    # Rounding of P, of 10 m^2, with the variance of 1e-2 m^2 of the difference.
    np.testing.assert_allclose(state.x_hat, known.state.x_hat, atol=1e-9)
    np.testing.assert_allclose(P, P_known + unknown_place(state, at, sigma), atol=1e-9)


def test_landmarks_apart_stay_apart_however_uncertain_the_global_pose():
    points = np.vstack([POINTS[:2], POINTS[:1] + np.array([1.0, 0.0]), POINTS[3:]])
    filter_, landmarks = coarsely_started('fej', points, unknown=(5.0, 5.0, 0.3))

    assert merge_duplicates(filter_, landmarks) == {}


def test_a_map_whose_robots_have_left_keeps_its_duplicates():
    """It has no heading that could show in which directions landmarks differ."""
    filter_, _ = a_filter()
    filter_.state.remove(filter_.state.robots['r1'])

    LandmarkManager().merge(filter_, 'r1')

    assert len(filter_.state.landmarks) == len(POINTS)


def test_landmarks_that_are_likely_one_are_merged_under_the_older_id():
    filter_, landmarks = a_filter()

    assert merge_duplicates(filter_, landmarks) == {-4: -2}
    assert [key for _, key in filter_.state.landmarks] == [-2, -3, -5]


def test_the_present_id_of_a_landmark_is_that_of_the_last_one_into_which_it_was_merged():
    filter_, _ = a_filter()
    manager = LandmarkManager()

    manager.merge(filter_, 'r1')
    assert [manager.present_id(id_) for id_ in (-2, -3, -4, -5)] == [-2, -3, -2, -5]
    manager.replace_ids({-2: 7})
    assert [manager.present_id(id_) for id_ in (-2, -4, 7)] == [7, 7, 7]
    # A map that had the ID before may join another one.
    manager.replace_ids({7: -2})
    assert [manager.present_id(id_) for id_ in (-2, -4, 7)] == [-2, -2, -2]


def test_a_landmark_without_observed_id_is_merged_into_one_with_an_id():
    filter_, landmarks = a_filter()
    state = filter_.state
    landmarks[2].key = ('', 7)
    state.landmarks = {landmark.key: landmark for landmark in landmarks}

    assert merge_duplicates(filter_, landmarks) == {-2: 7}
    assert [key for _, key in state.landmarks] == [-3, 7, -5]


def test_landmarks_with_observed_ids_are_never_merged():
    filter_, landmarks = a_filter()
    for number, landmark in enumerate(landmarks):
        landmark.key = ('', number)
    filter_.state.landmarks = {landmark.key: landmark for landmark in landmarks}

    assert merge_duplicates(filter_, landmarks) == {}


@pytest.mark.parametrize('together', [slice(0, 4), slice(0, 3, 2)])
def test_landmarks_of_one_scan_are_never_merged(together):
    filter_, landmarks = a_filter()

    assert merge_duplicates(filter_, landmarks, observed_together=landmarks[together]) == {}
    assert merge_duplicates(filter_, landmarks) == {}


def test_landmarks_distinct_from_a_merged_one_stay_distinct():
    filter_, landmarks = a_filter()
    whole, _, part, beside = landmarks
    part.distinct.add(beside.key)

    assert merge_duplicates(filter_, [whole]) == {-4: -2}

    # At 0.1 m, about its standard deviation, both would be merged but for this.
    place = slice(beside.slot.start, beside.slot.stop)
    filter_.state.x_hat[place] = filter_.state.estimate(whole) + 0.1
    assert merge_duplicates(filter_, [whole, beside]) == {}


@pytest.mark.parametrize('away', [(1.0, 0.0), (0.0, 3.0)])
def test_landmarks_farther_apart_than_their_uncertainty_are_not_merged(away):
    filter_, landmarks = a_filter(np.vstack([POINTS[:2], POINTS[:1] + away, POINTS[3:]]))

    assert merge_duplicates(filter_, landmarks) == {}


def test_an_error_that_two_landmarks_share_does_not_make_them_one():
    # They are 1 m apart, known to 0.1 m in each other's frame and to 1 m in map.
    points = np.array([[0.0, 0.0], [1.0, 0.0], [20.0, 0.0]])
    P = 0.01 * np.eye(9)
    P[3:, 3:] += np.tile(np.eye(2), (3, 3))
    state, _ = a_map(points, P)
    filter_ = Filter(state, FirstEstimates(), Gate(1.0))

    assert merge_duplicates(filter_, [*state.landmarks.values()]) == {}


def test_landmarks_as_uncertain_as_their_spacing_are_not_merged():
    filter_, landmarks = a_filter(sigma=4.0)

    assert merge_duplicates(filter_, landmarks) == {}


def test_many_duplicates_are_removed_at_the_cost_of_one_and_on_the_whole_map(monkeypatch):
    """After a join, however large the map: each removal alone would copy the covariance."""
    corners = 10.0 * np.stack(np.meshgrid(range(16), range(10)), axis=-1).reshape(-1, 2)
    state, _ = a_map(np.vstack([corners, corners + 0.01]), 0.01 * np.eye(3 + 4 * len(corners)))
    filter_ = Filter(state, FirstEstimates(), Gate(1.0), submap=AROUND_ROBOTS)
    removed, pauses, remove_all = [], [], JointState.remove_all
    monkeypatch.setattr(JointState, 'remove_all', lambda state, variables: (
        removed.append(len(variables)), remove_all(state, variables)))

    with between_pieces(lambda: pauses.append(1)):
        merged = merge_duplicates(filter_, state.confirmed_landmarks())

    assert len(state.landmarks) == len(merged) == len(corners)
    assert removed == [len(corners)]
    assert len(pauses) >= len(corners)
    assert isinstance(state.covariance, Covariance)


def test_a_landmark_without_id_is_not_merged_with_one_of_a_robots_own_ids():
    """Only that robot's observations can be of its ID: others would start the landmark again."""
    state, _ = a_map(POINTS, 0.01 * np.eye(11))
    one, *others = state.landmarks.values()
    one.key = 'r1', 5
    own = JointState([*state.robots.values(), one, *others], state.x_hat, state.x_first,
                     state.covariance)

    merged = merge_duplicates(Filter(own, FirstEstimates(), Gate(1.0), False), others)

    assert merged == {}
