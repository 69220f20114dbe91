# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Observations are matched together, and rather not at all than wrongly."""

import numpy as np
import pytest

from helpers.core import turn
from helpers.matching import a_map, independent, match, observations, pairs_of, scored_hypotheses

CORNERS = np.array([[4.0, 0.0], [0.0, 5.0], [-3.0, 2.0], [5.0, 5.0]])
CERTAIN = independent((0.02, 0.02, 0.01), 0.05, 4)


def test_observations_at_expected_landmarks_are_matched_and_others_are_new():
    state, robot = a_map(CORNERS, CERTAIN)

    found = match(state, robot, observations([(0.1, 5.0), (9.0, -3.0), (4.0, 0.1), (-2.9, 2.0)]))

    assert found == ({0: 1, 2: 0, 3: 2}, [1], [])


def test_an_observation_between_two_landmarks_is_doubtful():
    state, robot = a_map([(4.0, 0.0), (4.0, 0.5)], independent((0.02, 0.02, 0.01), 0.05, 2))

    assert match(state, robot, observations([(4.0, 0.2)])) == ({}, [], [0])


def test_an_observation_near_a_landmark_beyond_the_gate_is_doubtful():
    state, robot = a_map(CORNERS, CERTAIN)

    # Its standard deviation is 0.12 m.
    assert match(state, robot, observations([(4.5, 0.0)])) == ({}, [], [0])


def test_an_uncertain_pose_needs_several_agreeing_matches():
    state, robot = a_map(CORNERS, independent((1.0, 1.0, 0.05), 0.05, 4))
    seen = CORNERS + np.array([0.8, -0.6])

    assert match(state, robot, observations(seen[:1])) == ({}, [], [0])
    assert match(state, robot, observations(seen))[0] == {0: 0, 1: 1, 2: 2, 3: 3}


def test_an_alternative_shift_makes_all_matches_doubtful():
    row = [(x, 3.0) for x in (-4.0, -2.0, 0.0, 2.0, 4.0)]
    state, robot = a_map(row, independent((2.0, 0.1, 0.01), 0.02, 5))

    matched, new, doubtful = match(state, robot, observations([(-1.0, 3.0), (1.0, 3.0)]))

    assert (matched, new, doubtful) == ({}, [], [0, 1])


def random_scan(rng, landmarks=4, seen=4, spread=2.0):
    """Return a crowded map, correlated in all parts, and a scan with one thing unknown."""
    points = rng.uniform(-spread, spread, (landmarks, 2))
    A = rng.normal(0.0, 0.12, (3 + 2 * landmarks,) * 2)
    A[2] *= 0.2
    P = A @ A.T + 1e-3 * np.eye(len(A))
    state, robot = a_map(points, P)
    x = rng.multivariate_normal(state.x_hat, P)
    z = (x[3:].reshape(-1, 2) - x[:2]) @ turn(x[2]) + rng.normal(0.0, 0.1, points.shape)
    z[-1] = rng.uniform(-spread, spread, 2)
    return state, robot, observations(z[:seen])


def most_likely(hypotheses, landmarks, observation):
    """Return the score of the likeliest hypothesis in which an observation is of a landmark."""
    return max((
        score for pairs, score in hypotheses if dict(pairs).get(observation) in landmarks),
        default=-np.inf)


def test_matches_are_unambiguous_among_all_hypotheses():
    of_others, of_nothing = [], []
    for seed in range(100):
        state, robot, seen = random_scan(np.random.default_rng(seed))
        hypotheses = [*scored_hypotheses(pairs_of(state, robot, seen))]
        best = max(score for _, score in hypotheses)
        for pair in match(state, robot, seen)[0].items():
            of_others.append(best - most_likely(hypotheses, {*range(4)} - {pair[1]}, pair[0]))
            of_nothing.append(best - most_likely(hypotheses, {None}, pair[0]))

    assert len(of_others) > 50
    assert min(of_nothing) > np.log(3.0)
    assert min(of_others) > np.log(10.0)
    # The search is greedy: among so many close things it overlooks a hypothesis now and then.
    assert np.mean(np.array(of_others) < np.log(100.0)) < 0.03


def test_a_match_far_likelier_than_all_others_is_accepted():
    agreed = []
    for seed in range(100):
        state, robot, seen = random_scan(np.random.default_rng(seed), spread=4.0)
        (first, best), (_, second) = sorted(
            scored_hypotheses(pairs_of(state, robot, seen, 9.0)), key=lambda h: -h[1])[:2]
        if best - second > np.log(100.0):
            matched, _, _ = match(state, robot, seen, odds=9.0)
            agreed.append({*matched.items()} == first)

    # One right match in a hundred fails the test, and caution costs some.
    assert len(agreed) > 30
    assert np.mean(agreed) > 0.8


@pytest.mark.parametrize('seed', range(5))
def test_neither_the_order_of_observations_nor_that_of_landmarks_matters(seed):
    rng = np.random.default_rng(seed)
    state, robot, seen = random_scan(rng, landmarks=6, seen=6)
    matched, new, doubtful = match(state, robot, seen)
    order, landmark_order = rng.permutation(6), rng.permutation(6)
    variables = [robot, *(list(state.landmarks.values())[k] for k in landmark_order)]
    other, same_robot = a_map(
        state.x_hat[3:].reshape(-1, 2)[landmark_order], state.marginal(variables))

    again = match(other, same_robot, [seen[k] for k in order])

    assert {(order[i], landmark_order[f]) for i, f in again[0].items()} == {*matched.items()}
    assert [sorted(order[found]) for found in map(list, again[1:])] == [new, doubtful]


@pytest.mark.parametrize('probability', [0.8, 0.99])
def test_correct_matches_pass_with_the_configured_probability(probability):
    rng, passed, runs = np.random.default_rng(7), 0, 1000
    state, robot = a_map([(4.0, 0.0)], independent((0.05, 0.05, 0.01), 0.05, 1))
    # z - h has the variances of position and landmark, of the heading at 4 m, and 0.1^2.
    sigma = np.sqrt([0.015, 0.015 + 0.04**2])
    for _ in range(runs):
        z = rng.normal((4.0, 0.0), sigma)
        passed += match(state, robot, observations([z]), probability, odds=9.0)[0] == {0: 0}

    # Within four standard deviations of a binomial.
    assert abs(passed / runs - probability) < 4.0 * np.sqrt(
        probability * (1.0 - probability) / runs)


def test_with_too_many_candidates_nothing_is_matched():
    points = np.random.default_rng(1).uniform(-3.0, 3.0, (60, 2))
    state, robot = a_map(points, independent((5.0, 5.0, 0.5), 0.05, 60))

    matched, new, doubtful = match(state, robot, observations(points[:5]))

    assert (matched, new, doubtful) == ({}, [], [0, 1, 2, 3, 4])


def test_without_landmarks_all_observations_are_new():
    state, robot = a_map(np.empty((0, 2)), np.eye(3))

    assert match(state, robot, observations([(1.0, 0.0), (1.1, 0.0)])) == ({}, [0, 1], [])
