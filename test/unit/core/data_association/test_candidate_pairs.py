# SPDX-FileCopyrightText: 2026 The fej_slam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""To believe a pair is to condition all others on it."""

import numpy as np
import pytest

from fej_slam_ros.core import models
from fej_slam_ros.core.data_association.candidate_pairs import MAX_CANDIDATE_PAIRS, MAX_PAIR_D2
from helpers.core import central_differences, quarter_turn, turn
from helpers.matching import a_map, independent, match, observations, ODDS, pairs_of

POSE = np.array([1.0, -2.0, 0.7])
POINTS = np.array([[4.0, 0.0], [2.0, 2.0], [-3.0, 1.0], [4.5, 0.5]])


def a_scan(seed=4, metre=1.0):
    """Return a state whose covariance knows no zero, and a scan of its landmarks."""
    rng = np.random.default_rng(seed)
    A = rng.normal(0.0, 0.15, (11, 11))
    unit = np.array([metre, metre, 1.0, *[metre] * 8])
    state, robot = a_map(
        metre * POINTS, np.outer(unit, unit) * (A @ A.T + 0.01 * np.eye(11)), unit[:3] * POSE)
    z = (POINTS - POSE[:2]) @ turn(POSE[2]) + rng.normal(0.0, 0.1, POINTS.shape)
    return state, robot, observations(metre * z, 0.1 * metre)


def second_order(P, H):
    """Return what the second-order error of the heading adds to the covariance H P H^T."""
    turned = np.ravel([quarter_turn(v) for v in (H @ P[:, 2]).reshape(-1, 2)])
    return 0.75 * np.outer(turned, turned)


def test_innovations_have_their_joint_covariance():
    state, robot, observations = a_scan()

    def h(x):
        return (turn(x[2]).T @ (x[3:].reshape(-1, 2) - x[:2]).T).T.ravel()

    pairs = pairs_of(state, robot, observations)
    diagonal = [p for p in range(len(pairs)) if pairs[p][0] == pairs[p][1]]
    rows = np.ravel([[p, p + len(pairs)] for p in diagonal])
    x = np.concatenate([POSE, POINTS.ravel()])
    H = central_differences(h, x)
    P = state.marginal([robot, *state.landmarks.values()])
    z = np.ravel([s.z for s in observations])
    # Central differences are right to 1e-9.
    np.testing.assert_allclose(
        pairs.S[np.ix_(rows, rows)], H @ P @ H.T + second_order(P, H) + 0.01 * np.eye(8),
        atol=1e-8)
    np.testing.assert_allclose(pairs.r[rows], z - h(x), atol=1e-12)


def test_across_its_first_order_error_an_innovation_varies_by_that_of_a_turned_drive():
    """The start of a drive was turned by theta, and the pose with it along a circle."""
    sigma, drive = 0.1, POSE[:2]
    first_order = np.array([*quarter_turn(drive), 1.0])
    P = 1e-12 * np.eye(11)
    P[:3, :3] += sigma**2 * np.outer(first_order, first_order)
    state, robot = a_map(POINTS, P, POSE)
    theta, weight = np.polynomial.hermite_e.hermegauss(20)
    seen = (POINTS - POSE[:2]) @ turn(POSE[2])

    pairs = pairs_of(state, robot, observations(seen))

    for k, point in enumerate(POINTS):
        p = pairs.index((k, k))
        z = np.array([
            turn(POSE[2] + t).T @ (point - turn(t) @ drive) for t in sigma * theta])
        across = quarter_turn(turn(POSE[2]).T @ quarter_turn(point)) / np.hypot(*point)
        # Of fourth order in sigma; the next one is 0.8 % of it.
        expected = weight @ np.square((z - seen[k]) @ across) / weight.sum()
        S = pairs.S[p::len(pairs), p::len(pairs)]
        assert across @ S @ across - 0.01 == pytest.approx(expected, rel=0.02)


def test_an_error_that_landmarks_share_with_the_robot_is_none_of_an_innovation():
    state, robot = a_map(POINTS, 1e-12 * np.eye(11) + unknown_turn(0.5), POSE)
    seen = observations((POINTS - POSE[:2]) @ turn(POSE[2]))

    pairs = pairs_of(state, robot, seen)

    own = [p + c for k in range(4) for p in [pairs.index((k, k))] for c in (0, len(pairs))]
    np.testing.assert_allclose(pairs.S[np.ix_(own, own)], 0.01 * np.eye(8), atol=1e-9)


def unknown_turn(sigma):
    """Return the covariance of an unknown turn of everything about the origin."""
    turned = [*quarter_turn(POSE[:2]), 1.0, *np.ravel([quarter_turn(p) for p in POINTS])]
    return sigma**2 * np.outer(turned, turned)


@pytest.mark.parametrize('seed', range(20))
def test_no_pair_within_the_limit_is_left_out(seed):
    state, robot, observations = a_scan(seed)
    poses = np.tile(POSE, (4, 1))
    r = np.array([s.z for s in observations])[:, None] - models.h(poses, POINTS)
    H = models.H(poses, POINTS)
    P = [state.marginal([robot, landmark]) for landmark in state.landmarks.values()]
    S = [H[f] @ P[f] @ H[f].T + second_order(P[f], H[f]) + 0.01 * np.eye(2) for f in range(4)]

    pairs = pairs_of(state, robot, observations)

    assert {pairs[p] for p in range(len(pairs))} == {
        (i, f) for i in range(4) for f in range(4)
        if r[i, f] @ np.linalg.solve(S[f], r[i, f]) < MAX_PAIR_D2}


@pytest.mark.parametrize('accepted', range(4))
def test_remaining_pairs_are_conditioned_on_the_accepted_ones(accepted):
    pairs = pairs_of(*a_scan())
    k = len(pairs)
    own = [accepted, accepted + k]
    left = pairs.conditioned_on(accepted)

    kept = [p for p in range(k) if left.index(pairs[p]) is not None]
    rows = [*kept, *(p + k for p in kept)]
    K = pairs.S[np.ix_(rows, own)] @ np.linalg.inv(pairs.S[np.ix_(own, own)])
    np.testing.assert_allclose(left.r, pairs.r[rows] - K @ pairs.r[own], atol=1e-12)
    np.testing.assert_allclose(
        left.S, pairs.S[np.ix_(rows, rows)] - K @ pairs.S[np.ix_(own, rows)], atol=1e-12)


def test_an_observation_and_a_landmark_are_in_one_accepted_pair_only():
    pairs = pairs_of(*a_scan())
    i, f = pairs[0]

    left = pairs.conditioned_on(0)

    assert all(left[p][0] != i and left[p][1] != f for p in range(len(left)))


def test_successive_gains_add_up_to_the_joint_likelihood_ratio():
    pairs = pairs_of(*a_scan())
    together = [(0, 0), (1, 1), (2, 2)]
    rows = [pairs.index(pair) for pair in together]
    rows += [p + len(pairs) for p in rows]
    r, S = pairs.r[rows], pairs.S[np.ix_(rows, rows)]

    spoken, left = 0.0, pairs
    for pair in together:
        spoken += left.weights.gains[left.index(pair)]
        left = left.conditioned_on(left.index(pair))

    expected = 3 * ODDS - 0.5 * (r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1])
    assert spoken == pytest.approx(expected, abs=1e-9)


def test_weights_given_others_equal_those_of_the_pair_accepted_last():
    pairs = pairs_of(*a_scan())
    chosen = pairs.subset(np.array([pairs.index((k, k)) for k in range(3)]))

    left = chosen.conditioned_on(0)
    left = left.conditioned_on(left.index((1, 1)))

    given_others = [float(weight[2]) for weight in chosen.weights_given_others]
    assert given_others == pytest.approx([float(w[0]) for w in left.weights], abs=1e-9)


def test_weights_do_not_depend_on_the_unit_of_length():
    in_m = pairs_of(*a_scan())

    # The odds are for 1 m^2 and for 1 cm^2.
    in_cm = pairs_of(*a_scan(metre=100.0), odds=ODDS + np.log(100.0 ** 2))

    np.testing.assert_allclose(in_cm.weights, in_m.weights, atol=1e-9)
    np.testing.assert_allclose(
        in_cm.weights_given_others, in_m.weights_given_others, rtol=1e-9, atol=1e-6)


def test_no_gain_exceeds_its_upper_bound():
    pairs = pairs_of(*a_scan())
    for first in range(len(pairs)):
        left = pairs.conditioned_on(first)
        # Equal but for rounding where nothing else is left.
        assert (left.weights.gains <= left.max_gain + 1e-9).all()


def test_an_observation_far_from_all_landmarks_has_no_pair():
    state, robot, _ = a_scan()

    assert len(pairs_of(state, robot, observations([(30.0, 0.0)]))) == 0


def test_without_landmarks_there_is_no_pair():
    state, robot = a_map(np.empty((0, 2)), np.eye(3))

    assert len(pairs_of(state, robot, observations([(1.0, 0.0)]))) == 0


def test_of_too_many_pairs_no_covariance_is_made_and_all_are_ambiguous():
    rng = np.random.default_rng(6)
    points = rng.normal([5.0, 0.0], 0.1, (40, 2))
    state, robot = a_map(points, independent([0.1, 0.1, 0.01], 0.3, 40))
    crowd = observations(rng.normal([5.0, 0.0], 0.1, (30, 2)))

    pairs = pairs_of(state, robot, crowd)

    assert len(pairs) == 1200 > MAX_CANDIDATE_PAIRS
    assert not pairs.S.size
    assert match(state, robot, crowd) == ({}, [], [*range(30)])
